// The visible splats, nearest first, and how many pairs of a tile and a splat those before each make.
// A work group deals with a block of consecutive slots, each of its invocations with a run of them.
// Flags: WORKGROUP, RUN, BLOCK (their product), and those of outline.
#include "tiles/outline.glsl"

layout(local_size_x = WORKGROUP) in;

layout(std430, binding = 0) readonly buffer Order { uint order[]; };
layout(std430, binding = 1) readonly buffer Visible { uint visible; };

// This invocation's slots, as first and one past the last.
uvec2 own_slots() {
    uint first = gl_WorkGroupID.x * uint(BLOCK) + gl_LocalInvocationID.x * uint(RUN);
    return uvec2(first, min(first + uint(RUN), visible));
}
