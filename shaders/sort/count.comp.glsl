// Counts the keys of each digit value in each block.

#include "sort/blocks.glsl"
#include "sort/own_counts.glsl"

void main() {
    if (group_number() >= plan.blocks) return;
    count_own_keys();
    for (uint d = gl_LocalInvocationID.x; d < uint(RADIX); d += uint(WORKGROUP)) {
        uint sum = 0u;
        for (uint i = 0u; i < uint(WORKGROUP); ++i)
            sum += own_counts[d * uint(WORKGROUP) + i];
        table[d * plan.blocks + group_number()] = sum;
    }
}
