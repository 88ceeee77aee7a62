// Appends the visible splats in the order of their indices: with a stable sort after it, splats of equal
// depth are drawn by index, the same in every frame, which slots from an atomic counter would not give.
// Flags: GROUP_SIZE, KEPT (in a reused depth order of all splats instead, which takes no sort).
#include "quads/culled.glsl"
#include "common/groups.glsl"
layout(local_size_x = GROUP_SIZE) in;

layout(std430, binding = 0) readonly buffer DepthKeys { uint depth_keys[]; };
layout(std430, binding = 1) readonly buffer GroupStarts { uint group_starts[]; };
layout(std430, binding = 2) writeonly buffer Keys { uint keys[]; };
layout(std430, binding = 3) writeonly buffer Order { uint order[]; };
#if HAS_KEPT
layout(std430, binding = 4) readonly buffer ReusedOrder { uint reused[]; };
#endif
uniform uint u_splats;
uniform uint u_key_base;   // keys are counted from it...
uniform uint u_key_shift;  // ... and lose so many bits
uniform uint u_key_most;

const uint WORDS = uint(GROUP_SIZE) / 32u;
shared uint visible_bits[WORDS];

void main() {
    uint me = gl_LocalInvocationID.x, splat = group_number() * uint(GROUP_SIZE) + me;
    uint word = me / 32u, bit = me % 32u;
    if (me < WORDS) visible_bits[me] = 0u;
    memoryBarrierShared(); barrier();
    uint key = CULLED;
    if (splat < u_splats) {
#if HAS_KEPT
        splat = reused[splat];
#endif
        key = depth_keys[splat];
    }
    if (key != CULLED) atomicOr(visible_bits[word], 1u << bit);
    memoryBarrierShared(); barrier();
    if (key == CULLED) return;
    uint slot = group_starts[group_number()];
    for (uint below = 0u; below < word; below++) slot += uint(bitCount(visible_bits[below]));
    slot += uint(bitCount(visible_bits[word] & ((1u << bit) - 1u)));
    if (!KEPT) keys[slot] = min((max(key, u_key_base) - u_key_base) >> u_key_shift, u_key_most);
    order[slot] = splat;
}
