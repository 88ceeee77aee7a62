// What editing has noted of each splat, see scene/edits.py; only variants that ask for it have the texture.
// Flags: HIDES, ADJUSTS, TINTS, TEXTURE_WIDTH, PALETTE_SHIFT, NOT_SHOWN (state flags), TINT_COUNT.
#include "common/texels.glsl"

#if HIDES || ADJUSTS || TINTS
uniform usampler2D u_marks;

uint mark_of(uint splat) { return texelFetch(u_marks, texel_of(splat), 0).r; }
#endif
