// Prefix sum over a workgroup (Hillis and Steele 1986). Flag: WORKGROUP.

shared uint sums[WORKGROUP];

// The sum of the values of the invocations before this one. Every invocation must call it.
uint sum_before(uint value) {
    uint me = gl_LocalInvocationID.x;
    sums[me] = value;
    memoryBarrierShared(); barrier();
    for (uint stride = 1u; stride < uint(WORKGROUP); stride <<= 1u) {
        uint below = me >= stride ? sums[me - stride] : 0u;
        memoryBarrierShared(); barrier();
        sums[me] += below;
        memoryBarrierShared(); barrier();
    }
    uint before = sums[me] - value;
    memoryBarrierShared(); barrier();  // before another call writes
    return before;
}
