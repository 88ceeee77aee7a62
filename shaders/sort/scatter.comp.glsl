// Moves each key and its value to where its digit belongs, keeping the order of equal digits.

#include "sort/blocks.glsl"
#include "sort/own_counts.glsl"
#include "sort/sum_before.glsl"

layout(std430, binding = 4) restrict readonly buffer Values { uint values[]; };
layout(std430, binding = 5) restrict writeonly buffer SortedKeys { uint sorted_keys[]; };
layout(std430, binding = 6) restrict writeonly buffer SortedValues { uint sorted_values[]; };

#define DIGITS_PER_INVOCATION ((RADIX + WORKGROUP - 1) / WORKGROUP)

// [digit value]: offset from a rank in the block sorted by this digit to the place among all keys
shared uint offsets[RADIX];

// Replaces this block's counts by the rank in the block of the next key of that digit and invocation.
void ranks_from_counts() {
    // As many counts an invocation as there are digit values, in the order of the table.
    uint first = gl_LocalInvocationID.x * uint(RADIX);
    uint sum = 0u;
    for (uint i = first; i < first + uint(RADIX); ++i)
        sum += own_counts[i];
    uint rank = sum_before(sum);
    for (uint i = first; i < first + uint(RADIX); ++i) {
        uint here = own_counts[i];
        own_counts[i] = rank;
        rank += here;
    }
    memoryBarrierShared(); barrier();
}

void find_offsets() {
    uint first = min(gl_LocalInvocationID.x * uint(DIGITS_PER_INVOCATION), uint(RADIX));
    uint end = min(first + uint(DIGITS_PER_INVOCATION), uint(RADIX));
    uint sum = 0u;
    for (uint d = first; d < end; ++d)
        sum += totals[d];
    uint smaller = sum_before(sum);  // keys of smaller digit values, in all blocks
    for (uint d = first; d < end; ++d) {
        offsets[d] = smaller + table[d * plan.blocks + group_number()] - own_counts[d * uint(WORKGROUP)];
        smaller += totals[d];
    }
    memoryBarrierShared(); barrier();
}

void main() {
    if (group_number() >= plan.blocks) return;
    count_own_keys();
    ranks_from_counts();
    find_offsets();
    uvec2 run = own_run();
    for (uint i = run.x; i < run.y; ++i) {
        uint key = keys[i];
        uint digit = (key >> shift) & uint(RADIX - 1);
        uint place = offsets[digit] + own_counts[counter(key)]++;
        sorted_keys[place] = key;
        sorted_values[place] = values[i];
    }
}
