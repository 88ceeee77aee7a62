// Turns each digit value's counts into the keys in earlier blocks. One workgroup a digit value.

#include "sort/blocks.glsl"

shared uint sums[WORKGROUP];

void main() {
    uint row = gl_WorkGroupID.x * plan.blocks;
    uint share = (plan.blocks + uint(WORKGROUP) - 1u) / uint(WORKGROUP);
    uint first = min(gl_LocalInvocationID.x * share, plan.blocks);
    uint end = min(first + share, plan.blocks);

    uint sum = 0u;
    for (uint i = first; i < end; ++i)
        sum += table[row + i];
    sums[gl_LocalInvocationID.x] = sum;
    barrier();

    uint before = 0u;
    for (uint i = 0u; i < gl_LocalInvocationID.x; ++i)
        before += sums[i];
    for (uint i = first; i < end; ++i) {
        uint here = table[row + i];
        table[row + i] = before;
        before += here;
    }
    if (gl_LocalInvocationID.x == uint(WORKGROUP - 1))
        totals[gl_WorkGroupID.x] = before;
}
