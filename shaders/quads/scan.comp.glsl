// Exclusive prefix sum of the groups' visible counts, by one work group; also the draw's arguments.
// Flags: SCAN_SIZE (invocations), QUADS_PER_INSTANCE.
layout(local_size_x = SCAN_SIZE) in;

layout(std430, binding = 0) buffer GroupCounts { uint group_counts[]; };
layout(std430, binding = 1) writeonly buffer GroupStarts { uint group_starts[]; };
layout(std430, binding = 2) writeonly buffer Visible { uint visible; };
layout(std430, binding = 3) writeonly buffer Command { uint command[5]; };  // DrawElementsIndirectCommand
uniform uint u_groups;

shared uint sums[SCAN_SIZE];

void main() {
    uint me = gl_LocalInvocationID.x;
    uint share = (u_groups + uint(SCAN_SIZE) - 1u) / uint(SCAN_SIZE);
    uint first = min(me * share, u_groups), last = min(first + share, u_groups);
    uint sum = 0u;
    for (uint group = first; group < last; group++) sum += group_counts[group];
    sums[me] = sum;
    barrier();
    for (uint reach = 1u; reach < uint(SCAN_SIZE); reach <<= 1u) {
        uint below = me >= reach ? sums[me - reach] : 0u;
        barrier();
        sums[me] += below;
        barrier();
    }
    uint start = sums[me] - sum;
    for (uint group = first; group < last; group++) {
        group_starts[group] = start;
        start += group_counts[group];
        group_counts[group] = 0u;  // ready for the next projection
    }
    if (me == uint(SCAN_SIZE) - 1u) {
        visible = sums[me];
        command[0] = 6u * uint(QUADS_PER_INSTANCE);
        command[1] = (sums[me] + uint(QUADS_PER_INSTANCE) - 1u) / uint(QUADS_PER_INSTANCE);
        command[2] = 0u;
        command[3] = 0u;
        command[4] = 0u;
    }
}
