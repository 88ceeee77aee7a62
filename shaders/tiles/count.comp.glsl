// Counts the tiles of every visible splat. A work group has a block of consecutive slots, each of its
// invocations a run of them. Flags: WORKGROUP, RUN (BLOCK is their product), and those of slots.
#include "tiles/slots.glsl"
#include "sort/sum_before.glsl"
layout(local_size_x = WORKGROUP) in;

layout(std430, binding = 3) buffer Ends { uint ends[]; };  // a slot: pairs of its block up to and with it
layout(std430, binding = 4) writeonly buffer BlockTotals { uint block_totals[]; };

uint tiles_of(uint splat) {
    Outline o = outline_of(splat);
    ivec2 rows = rows_of(o);
    int sum = 0;
    for (int row = rows.x; row <= rows.y; row++) {
        ivec2 columns = columns_of(o, row);
        sum += max(columns.y - columns.x + 1, 0);
    }
    return uint(sum);
}

void main() {
    uint first = group_number() * uint(BLOCK) + gl_LocalInvocationID.x * uint(RUN);
    uint end = min(first + uint(RUN), visible);
    uint sum = 0u;
    for (uint slot = first; slot < end; slot++) {
        sum += tiles_of(order[slot]);
        ends[slot] = sum;
    }
    uint before = sum_before(sum);
    for (uint slot = first; slot < end; slot++) ends[slot] += before;
    if (gl_LocalInvocationID.x == uint(WORKGROUP - 1) && group_number() < uint(block_totals.length()))
        block_totals[group_number()] = before + sum;
}
