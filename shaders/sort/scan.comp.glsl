// Turns each digit value's counts into the keys in earlier blocks. One workgroup per digit value.

#include "sort/blocks.glsl"
#include "sort/sum_before.glsl"

void main() {
    uint row = gl_WorkGroupID.x * plan.blocks;
    uint share = (plan.blocks + uint(WORKGROUP) - 1u) / uint(WORKGROUP);
    uint first = min(gl_LocalInvocationID.x * share, plan.blocks);
    uint end = min(first + share, plan.blocks);

    uint sum = 0u;
    for (uint i = first; i < end; ++i)
        sum += table[row + i];
    uint before = sum_before(sum);
    for (uint i = first; i < end; ++i) {
        uint here = table[row + i];
        table[row + i] = before;
        before += here;
    }
    if (gl_LocalInvocationID.x == uint(WORKGROUP - 1))
        totals[gl_WorkGroupID.x] = before;
}
