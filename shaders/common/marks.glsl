// What editing has noted of each splat, see scene/edits.py; only programs that ask for it read the texture.
// Flags: TEXTURE_WIDTH, PALETTE_SHIFT, NOT_SHOWN (state flags), TINT_COUNT.
#include "common/texels.glsl"

uniform usampler2D u_marks;

uint mark_of(uint splat) { return texelFetch(u_marks, texel_of(splat), 0).r; }
