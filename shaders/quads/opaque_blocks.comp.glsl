// Marks blocks of BLOCK x BLOCK pixels as opaque: transmittance of every pixel below u_early_stop, so that no
// splat behind changes them visibly. An opaque block stays so: each pixel is read about once per frame. Flags: BLOCK.
#include "common/groups.glsl"
layout(local_size_x = 8) in;

layout(std430, binding = 0) buffer OpaqueBlocks { uint opaque[]; };
uniform sampler2D u_accumulation;  // rgb, T
uniform int u_columns;         // blocks
uniform int u_blocks;
uniform float u_early_stop;

void main() {
    int block = int(group_number() * gl_WorkGroupSize.x + gl_LocalInvocationID.x);
    if (block >= u_blocks || opaque[block] != 0u) return;
    ivec2 first = ivec2(block % u_columns, block / u_columns) * BLOCK;
    ivec2 last = min(first + BLOCK, textureSize(u_accumulation, 0));
    for (int y = first.y; y < last.y; y++)
        for (int x = first.x; x < last.x; x++)
            if (!(texelFetch(u_accumulation, ivec2(x, y), 0).a < u_early_stop)) return;
    opaque[block] = 1u;
}
