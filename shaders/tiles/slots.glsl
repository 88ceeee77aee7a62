// The visible splats, nearest first. Those of a block are counted together. Flags: BLOCK, and those of outline.
#include "tiles/outline.glsl"
#include "common/groups.glsl"

layout(std430, binding = 0) readonly buffer Order { uint order[]; };
layout(std430, binding = 1) readonly buffer Visible { uint visible; };
