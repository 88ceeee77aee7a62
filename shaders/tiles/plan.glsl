// What fits into this frame's rounds of pairs, and what is left over. Flag: ROUNDS (at most).

layout(std430, binding = 6) buffer PlanBuffer {
    uint rest_groups[3];        // indirect dispatch: a work group a tile, none where nothing is left over
    uint rest_first;            // the first slot that is left over
    uint rest_end;
    uint round_pairs[ROUNDS];
} plan;
