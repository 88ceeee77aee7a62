// Where element `index` of a linear array is in a texture. Flag: TEXTURE_WIDTH.

ivec2 texel_of(uint index) { return ivec2(index % uint(TEXTURE_WIDTH), index / uint(TEXTURE_WIDTH)); }
