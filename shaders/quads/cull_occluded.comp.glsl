// Culls the splats of one slab that lie wholly within opaque blocks. Flags: BLOCK, SLABS.
#include "common/numbers.glsl"
#include "quads/culled.glsl"
#include "common/groups.glsl"
#include "common/records.glsl"
layout(local_size_x = 64) in;

layout(std430, binding = 0) readonly buffer Order { uint order[]; };
layout(std430, binding = 1) readonly buffer Slabs { uint slab_starts[]; };
RECORDS_READ(2);
layout(std430, binding = 3) readonly buffer OpaqueBlocks { uint opaque[]; };
layout(std430, binding = 4) writeonly buffer Drawn { uint drawn[]; };  // order, or CULLED
uniform uint u_slab;
uniform int u_columns;
uniform vec2 u_size;

const int MOST_BLOCKS = 256;  // a splat over more is drawn: the test would cost more than it saves

bool is_occluded(uint splat) {
    vec2 mean = RECORD(shapes, splat).xy;
    vec4 bound = RECORD(bounds, splat);
    vec2 major = bound.zw;
    float ratio = bound.y / max(hypotenuse(major.xx, major.yy).x, 1e-30);
    vec2 extent = hypotenuse(major, ratio * major.yx) + 1.0;
    ivec2 first = ivec2(clamp(mean - extent, vec2(0.0), u_size - 1.0)) / BLOCK;
    ivec2 last = ivec2(clamp(mean + extent, vec2(0.0), u_size - 1.0)) / BLOCK;
    if ((last.x - first.x + 1) * (last.y - first.y + 1) > MOST_BLOCKS) return false;
    for (int y = first.y; y <= last.y; y++)
        for (int x = first.x; x <= last.x; x++)
            if (opaque[y * u_columns + x] == 0u) return false;
    return true;
}

void main() {
    uint slot = slab_starts[u_slab] + group_number() * gl_WorkGroupSize.x + gl_LocalInvocationID.x;
    if (slot >= slab_starts[u_slab + 1u]) return;
    uint splat = order[slot];
    drawn[slot] = is_occluded(splat) ? CULLED : splat;
}
