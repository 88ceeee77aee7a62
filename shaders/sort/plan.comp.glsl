// Reads how many keys there are and sets the sizes of the dispatches that follow. One invocation.

#include "sort/blocks.glsl"

layout(std430, binding = 3) restrict readonly buffer Count { uint counts[]; };

uniform uint count_index;
uniform uint capacity;

void main() {
    if (gl_LocalInvocationID.x != 0u) return;
    plan.count = min(counts[count_index], capacity);
    plan.blocks = (plan.count + uint(BLOCK) - 1u) / uint(BLOCK);
    uint rows = (plan.blocks + uint(MOST_GROUPS) - 1u) / uint(MOST_GROUPS);
    plan.block_groups = uint[3](rows > 0u ? (plan.blocks + rows - 1u) / rows : 0u, rows, 1u);
    plan.digit_groups = uint[3](plan.blocks > 0u ? uint(RADIX) : 0u, 1u, 1u);
}
