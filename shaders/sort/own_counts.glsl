// The keys of each digit value in each invocation's run.

layout(std430, binding = 3) restrict readonly buffer Keys { uint keys[]; };

uniform uint shift; // of the digit that this pass sorts by

// [digit value][invocation]
shared uint own_counts[RADIX * WORKGROUP];

uint counter(uint key) {
    return ((key >> shift) & uint(RADIX - 1)) * uint(WORKGROUP) + gl_LocalInvocationID.x;
}

// This invocation's keys, as first and one past the last.
uvec2 own_run() {
    uint first = group_number() * uint(BLOCK) + gl_LocalInvocationID.x * uint(KEYS_PER_INVOCATION);
    return uvec2(first, min(first + uint(KEYS_PER_INVOCATION), plan.count));
}

void count_own_keys() {
    for (uint d = 0u; d < uint(RADIX); ++d)
        own_counts[d * uint(WORKGROUP) + gl_LocalInvocationID.x] = 0u;
    uvec2 run = own_run();
    for (uint i = run.x; i < run.y; ++i)
        own_counts[counter(keys[i])]++;
    memoryBarrierShared(); barrier();
}
