// Distribution of the keys: a workgroup owns a block of consecutive keys, and each of its invocations a
// run of KEYS_PER_INVOCATION consecutive keys in it. Ranks then follow from counting alone, in the
// order of the input, so the sort is stable without atomics or any promise about scheduling.
//
// Flags: WORKGROUP, KEYS_PER_INVOCATION, DIGIT_BITS, MOST_GROUPS (of a dispatch, in one dimension).
#include "common/groups.glsl"

#define RADIX (1 << DIGIT_BITS)
#define BLOCK (WORKGROUP * KEYS_PER_INVOCATION)

layout(local_size_x = WORKGROUP) in;

struct Plan {
    uint block_groups[3]; // indirect dispatch: one workgroup per block, in rows, and a few too many
    uint count;
    uint digit_groups[3]; // indirect dispatch: one workgroup per digit value, none where there are no keys
    uint blocks;
};

layout(std430, binding = 0) restrict buffer PlanBuffer { Plan plan; };
layout(std430, binding = 1) restrict buffer CountTable {
    uint table[]; // [digit value][block]: keys, after the scan the keys in earlier blocks
};
layout(std430, binding = 2) restrict buffer DigitTotals {
    uint totals[]; // [digit value]
};
