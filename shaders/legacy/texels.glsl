// Where a splat's values are in a texture. Flag: TEXTURE_WIDTH.

ivec2 texel_of(uint splat) { return ivec2(splat % uint(TEXTURE_WIDTH), splat / uint(TEXTURE_WIDTH)); }
