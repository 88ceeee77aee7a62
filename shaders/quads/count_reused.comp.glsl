// Counts the visible splats of each group of a reused depth order of all splats. Flags: GROUP_SIZE.
#include "quads/culled.glsl"
#include "common/groups.glsl"
layout(local_size_x = GROUP_SIZE) in;

layout(std430, binding = 0) readonly buffer DepthKeys { uint depth_keys[]; };
layout(std430, binding = 1) readonly buffer ReusedOrder { uint reused[]; };
layout(std430, binding = 2) writeonly buffer GroupCounts { uint group_counts[]; };
uniform uint u_splats;

shared uint visible;

void main() {
    if (gl_LocalInvocationID.x == 0u) visible = 0u;
    memoryBarrierShared(); barrier();
    uint first = group_number() * uint(GROUP_SIZE), place = first + gl_LocalInvocationID.x;
    if (place < u_splats && depth_keys[reused[place]] != CULLED) atomicAdd(visible, 1u);
    memoryBarrierShared(); barrier();
    if (place == first && first < u_splats) group_counts[group_number()] = visible;
}
