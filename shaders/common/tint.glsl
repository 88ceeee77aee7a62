// Highlights splats by their flags, for editing. Flags: TINTS, and those of marks.
#include "common/marks.glsl"

uniform vec4 u_tints[TINT_COUNT];  // colour and strength by state flags

vec3 tinted(uint splat, vec3 rgb) {
    if (!TINTS) return rgb;
    vec4 tint = u_tints[mark_of(splat) & uint(TINT_COUNT - 1)];
    return mix(rgb, tint.rgb, tint.a);
}
