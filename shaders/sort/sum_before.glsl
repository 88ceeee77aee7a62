// Prefix sum over a workgroup (Hillis and Steele 1986). Flag: WORKGROUP.

shared uint sums[WORKGROUP];

// The sum of the values of the invocations before this one. Every invocation must call it.
uint sum_before(uint value) {
    uint me = gl_LocalInvocationID.x;
    sums[me] = value;
    barrier();
    for (uint reach = 1u; reach < uint(WORKGROUP); reach <<= 1u) {
        uint below = me >= reach ? sums[me - reach] : 0u;
        barrier();
        sums[me] += below;
        barrier();
    }
    uint before = sums[me] - value;
    barrier();  // before another call writes
    return before;
}
