// The pairs of this frame's rounds, and the splats left over, if any. Flag: ROUNDS (at most).

layout(std430, binding = 3) buffer PlanBuffer {
    uint rest_first;            // the first slot that is left over
    uint rest_end;
    uint round_pairs[ROUNDS];
} plan;
