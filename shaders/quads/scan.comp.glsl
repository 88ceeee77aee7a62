// Exclusive prefix sum of the groups' visible counts, by one work group; also the draw's arguments.
// Flags: SCAN_SIZE (invocations), QUADS_PER_INSTANCE, SLABS.
layout(local_size_x = SCAN_SIZE) in;

layout(std430, binding = 0) buffer GroupCounts { uint group_counts[]; };
layout(std430, binding = 1) writeonly buffer GroupStarts { uint group_starts[]; };
layout(std430, binding = 2) writeonly buffer Visible { uint visible; };
layout(std430, binding = 3) writeonly buffer Commands { uint commands[]; };  // one DrawElementsIndirectCommand per slab
layout(std430, binding = 4) writeonly buffer Slabs { uint slab_starts[]; };
uniform uint u_groups;

shared uint sums[SCAN_SIZE];

void main() {
    uint me = gl_LocalInvocationID.x;
    uint share = (u_groups + uint(SCAN_SIZE) - 1u) / uint(SCAN_SIZE);
    uint first = min(me * share, u_groups), last = min(first + share, u_groups);
    uint sum = 0u;
    for (uint group = first; group < last; group++) sum += group_counts[group];
    sums[me] = sum;
    memoryBarrierShared(); barrier();
    for (uint stride = 1u; stride < uint(SCAN_SIZE); stride <<= 1u) {
        uint below = me >= stride ? sums[me - stride] : 0u;
        memoryBarrierShared(); barrier();
        sums[me] += below;
        memoryBarrierShared(); barrier();
    }
    uint start = sums[me] - sum;
    for (uint group = first; group < last; group++) {
        group_starts[group] = start;
        start += group_counts[group];
        group_counts[group] = 0u;  // ready for the next projection
    }
    if (me == uint(SCAN_SIZE) - 1u) {
        visible = sums[me];
        // In whole numbers: float32 counts to 2^24.
        uint start = 0u, share = sums[me] / uint(SLABS), rest = sums[me] % uint(SLABS);
        for (uint slab = 0u; slab < uint(SLABS); slab++) {
            uint end = (slab + 1u) * share + (slab + 1u) * rest / uint(SLABS);
            slab_starts[slab] = start;
            commands[5u * slab] = 6u * uint(QUADS_PER_INSTANCE);
            commands[5u * slab + 1u] = (end - start + uint(QUADS_PER_INSTANCE) - 1u) / uint(QUADS_PER_INSTANCE);
            for (uint rest = 2u; rest < 5u; rest++) commands[5u * slab + rest] = 0u;
            start = end;
        }
        slab_starts[SLABS] = start;
    }
}
