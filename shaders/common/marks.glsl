// Flags and palette index of each splat (marks of scene/edits.py); only programs that use them read the texture.
// Flags: TEXTURE_WIDTH, PALETTE_SHIFT, NOT_SHOWN and FILE_LOCKED (state flags), TINT_COUNT.
#include "common/texels.glsl"

uniform usampler2D u_marks;

uint mark_of(uint splat) { return texelFetch(u_marks, texel_of(splat), 0).r; }
