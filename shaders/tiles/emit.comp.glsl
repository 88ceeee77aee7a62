// Writes one round's pairs of tile and splat, nearest splat first; one invocation per splat.
// Flags: those of slots.
#include "tiles/slots.glsl"
#include "tiles/saturating.glsl"
layout(local_size_x = BLOCK) in;

layout(std430, binding = 3) readonly buffer Ends { uint ends[]; };
layout(std430, binding = 4) readonly buffer Starts { uint block_starts[]; };
layout(std430, binding = 5) writeonly buffer PairTiles { uint pair_tiles[]; };
layout(std430, binding = 6) writeonly buffer PairSplats { uint pair_splats[]; };
uniform uint u_round_first;  // pairs in earlier rounds
uniform uint u_capacity;     // pairs per round
uniform uint u_room;         // pairs in all rounds

void write_pair(uint at, uint tile, uint splat) {
    if (at < u_round_first || at - u_round_first >= u_capacity) return;
    pair_tiles[at - u_round_first] = tile;
    pair_splats[at - u_round_first] = splat;
}

void main() {
    uint slot = group_number() * uint(BLOCK) + gl_LocalInvocationID.x;
    if (slot >= visible) return;
    uint block_start = block_starts[slot / uint(BLOCK)];
    uint at = saturating_sum(block_start, slot % uint(BLOCK) > 0u ? ends[slot - 1u] : 0u);
    uint end = saturating_sum(block_start, ends[slot]);
    if (end > u_room || end <= u_round_first || at >= u_round_first + u_capacity) return;
    uint splat = order[slot];
    Outline o = outline_of(splat);
    ivec2 rows = rows_of(o);
    for (int row = rows.x; row <= rows.y; row++) {
        ivec2 columns = columns_of(o, row);
        for (int column = columns.x; column <= columns.y && at < end; column++)
            write_pair(at++, uint(row * u_tiles.x + column), splat);
    }
    // A compiler may round otherwise here than in the count: surplus pairs are in no tile.
    while (at < end) write_pair(at++, uint(u_tiles.x * u_tiles.y), splat);
}
