// Closes blocks of BLOCK x BLOCK pixels that nothing behind can change visibly: transmittance of every pixel
// below u_early_stop. A closed block stays closed, so each pixel is looked at about once a frame. Flags: BLOCK.
layout(local_size_x = 8) in;

layout(std430, binding = 0) buffer Closed { uint closed[]; };
uniform sampler2D u_gathered;  // rgb, T
uniform int u_columns;         // blocks
uniform int u_blocks;
uniform float u_early_stop;

void main() {
    int block = int(gl_GlobalInvocationID.x);
    if (block >= u_blocks || closed[block] != 0u) return;
    ivec2 first = ivec2(block % u_columns, block / u_columns) * BLOCK;
    ivec2 last = min(first + BLOCK, textureSize(u_gathered, 0));
    for (int y = first.y; y < last.y; y++)
        for (int x = first.x; x < last.x; x++)
            if (!(texelFetch(u_gathered, ivec2(x, y), 0).a < u_early_stop)) return;
    closed[block] = 1u;
}
