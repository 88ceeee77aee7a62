// Counts the tiles of every visible splat. Flags: those of slots.
#include "tiles/slots.glsl"
#include "sort/sum_before.glsl"

layout(std430, binding = 5) buffer Ends { uint ends[]; };  // a slot: pairs of its block up to and with it
layout(std430, binding = 6) writeonly buffer BlockTotals { uint block_totals[]; };

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
    uvec2 own = own_slots();
    uint sum = 0u;
    for (uint slot = own.x; slot < own.y; slot++) {
        sum += tiles_of(order[slot]);
        ends[slot] = sum;
    }
    uint before = sum_before(sum);
    for (uint slot = own.x; slot < own.y; slot++) ends[slot] += before;
    if (gl_LocalInvocationID.x == uint(WORKGROUP - 1)) block_totals[gl_WorkGroupID.x] = before + sum;
}
