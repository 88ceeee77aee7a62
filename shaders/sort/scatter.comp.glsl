// Moves each key and its value to where its digit belongs, keeping the order of equal digits.

#include "sort/blocks.glsl"
#include "sort/own_counts.glsl"

layout(std430, binding = 4) restrict readonly buffer Values { uint values[]; };
layout(std430, binding = 5) restrict writeonly buffer SortedKeys { uint sorted_keys[]; };
layout(std430, binding = 6) restrict writeonly buffer SortedValues { uint sorted_values[]; };

#define DIGITS_PER_INVOCATION ((RADIX + WORKGROUP - 1) / WORKGROUP)

shared uint sums[WORKGROUP];

// Replaces counts by the place of the next key of that digit value and invocation.
void places_from_counts() {
    uint first = min(gl_LocalInvocationID.x * uint(DIGITS_PER_INVOCATION), uint(RADIX));
    uint end = min(first + uint(DIGITS_PER_INVOCATION), uint(RADIX));
    uint sum = 0u;
    for (uint d = first; d < end; ++d)
        sum += totals[d];
    sums[gl_LocalInvocationID.x] = sum;
    barrier();
    uint smaller = 0u; // keys of smaller digit values, in all blocks
    for (uint i = 0u; i < gl_LocalInvocationID.x; ++i)
        smaller += sums[i];
    for (uint d = first; d < end; ++d) {
        uint place = smaller + table[d * plan.blocks + gl_WorkGroupID.x];
        smaller += totals[d];
        for (uint i = 0u; i < uint(WORKGROUP); ++i) {
            uint here = own_counts[d * uint(WORKGROUP) + i];
            own_counts[d * uint(WORKGROUP) + i] = place;
            place += here;
        }
    }
    barrier();
}

void main() {
    count_own_keys();
    places_from_counts();
    uvec2 run = own_run();
    for (uint i = run.x; i < run.y; ++i) {
        uint key = keys[i];
        uint place = own_counts[counter(key)]++;
        sorted_keys[place] = key;
        sorted_values[place] = values[i];
    }
}
