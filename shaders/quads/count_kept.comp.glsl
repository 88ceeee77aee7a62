// Counts, of each group of places in an order of all splats, those that are seen. Flags: GROUP_SIZE.
#include "quads/culled.glsl"
layout(local_size_x = GROUP_SIZE) in;

layout(std430, binding = 0) readonly buffer DepthKeys { uint depth_keys[]; };
layout(std430, binding = 1) readonly buffer Kept { uint kept[]; };
layout(std430, binding = 2) writeonly buffer GroupCounts { uint group_counts[]; };
uniform uint u_splats;

shared uint seen;

void main() {
    if (gl_LocalInvocationID.x == 0u) seen = 0u;
    barrier();
    uint place = gl_GlobalInvocationID.x;
    if (place < u_splats && depth_keys[kept[place]] != CULLED) atomicAdd(seen, 1u);
    barrier();
    if (gl_LocalInvocationID.x == 0u) group_counts[gl_WorkGroupID.x] = seen;
}
