// A page's spherical harmonics. Flags: SH_STORED (coefficients a splat has), SH_WORDS (32-bit words it has),
// ATTRIBUTES.

#if ATTRIBUTES == 0
layout(std430, binding = 3) readonly buffer Harmonics { float sh[]; };

vec3 sh_coefficient(uint splat, int index) {
    uint at = (splat * uint(SH_STORED) + uint(index)) * 3u;
    return vec3(sh[at], sh[at + 1u], sh[at + 2u]);
}
#else
layout(std430, binding = 3) readonly buffer Harmonics { uint sh[]; };

float half_at(uint splat, uint place) {
    vec2 pair = unpackHalf2x16(sh[splat * uint(SH_WORDS) + place / 2u]);
    return (place & 1u) == 0u ? pair.x : pair.y;
}

vec3 sh_coefficient(uint splat, int index) {
#if ATTRIBUTES == 2
    if (index > 0) {
        // After the constant band and the splat's step, a signed byte a number.
        uint first = uint(index - 1) * 3u;
        vec3 levels;
        for (uint channel = 0u; channel < 3u; channel++) {
            uint place = first + channel;
            uint word = sh[splat * uint(SH_WORDS) + 2u + place / 4u];
            levels[channel] = float(int(word << (24u - 8u * (place & 3u))) >> 24);
        }
        return levels * half_at(splat, 3u);
    }
#endif
    uint first = uint(index) * 3u;
    return vec3(half_at(splat, first), half_at(splat, first + 1u), half_at(splat, first + 2u));
}
#endif
