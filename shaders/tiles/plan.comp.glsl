// Deals the pairs out to rounds of `u_capacity`. Splats of which a pair finds no room are left over, from
// the first on, so that all before them are nearer. One invocation. Flags: BLOCK, ROUNDS.
#include "tiles/plan.glsl"
#include "tiles/saturating.glsl"
layout(local_size_x = 1) in;

layout(std430, binding = 0) readonly buffer Visible { uint visible; };
layout(std430, binding = 1) readonly buffer Ends { uint ends[]; };
layout(std430, binding = 2) readonly buffer Starts { uint block_starts[]; };
uniform uint u_capacity;  // pairs per round
uniform uint u_rounds;

uint end_of(uint slot) { return saturating_sum(block_starts[slot / uint(BLOCK)], ends[slot]); }

void main() {
    uint room = u_capacity * u_rounds;
    uint low = 0u, high = visible;
    while (low < high) {
        uint middle = (low + high) / 2u;
        if (end_of(middle) <= room) low = middle + 1u;
        else high = middle;
    }
    plan.rest_first = low;
    plan.rest_end = visible;
    uint placed = low > 0u ? end_of(low - 1u) : 0u;
    for (uint i = 0u; i < u_rounds; i++) {
        plan.round_pairs[i] = min(placed, u_capacity);
        placed -= plan.round_pairs[i];
    }
}
