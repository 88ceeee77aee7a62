// Turns the pairs of each block of slots into those of all blocks before, by one work group.
// Flag: WORKGROUP.
#include "tiles/saturating.glsl"
layout(local_size_x = WORKGROUP) in;

layout(std430, binding = 0) buffer Blocks { uint blocks[]; };  // totals, afterwards starts
layout(std430, binding = 1) writeonly buffer Pairs { uint pairs; };
uniform uint u_blocks;

shared uint sums[WORKGROUP];

void main() {
    uint me = gl_LocalInvocationID.x;
    uint share = (u_blocks + uint(WORKGROUP) - 1u) / uint(WORKGROUP);
    uint first = min(me * share, u_blocks), last = min(first + share, u_blocks);
    uint sum = 0u;
    for (uint block = first; block < last; block++) sum = saturating_sum(sum, blocks[block]);
    sums[me] = sum;
    memoryBarrierShared(); barrier();
    for (uint stride = 1u; stride < uint(WORKGROUP); stride <<= 1u) {
        uint below = me >= stride ? sums[me - stride] : 0u;
        memoryBarrierShared(); barrier();
        sums[me] = saturating_sum(sums[me], below);
        memoryBarrierShared(); barrier();
    }
    uint start = me > 0u ? sums[me - 1u] : 0u;
    for (uint block = first; block < last; block++) {
        uint here = blocks[block];
        blocks[block] = start;
        start = saturating_sum(start, here);
    }
    if (me == uint(WORKGROUP) - 1u) pairs = start;
}
