// A page's spherical harmonics. Flags: SH_WORDS (32-bit words per splat), OWN_DEGREES (splats have words by
// their own degrees, and places that say so come first: renderers/gl/scene_buffers.py), ATTRIBUTES.

layout(std430, binding = 3) readonly buffer Harmonics { uint sh[]; };

uint sh_place(uint splat) { return OWN_DEGREES ? sh[splat] : splat * uint(SH_WORDS); }

int sh_own_degree(uint place) { return OWN_DEGREES ? int(place & 3u) : 3; }

uint sh_word(uint place, uint word) { return sh[(OWN_DEGREES ? place >> 2u : place) + word]; }

#if ATTRIBUTES == 0
vec3 sh_coefficient(uint place, int index) {
    uint first = uint(index) * 3u;
    return uintBitsToFloat(
        uvec3(sh_word(place, first), sh_word(place, first + 1u), sh_word(place, first + 2u)));
}
#else
float half_at(uint place, uint number) {
    vec2 pair = unpackHalf2x16(sh_word(place, number / 2u));
    return (number & 1u) == 0u ? pair.x : pair.y;
}

vec3 sh_coefficient(uint place, int index) {
#if ATTRIBUTES == 2
    if (index > 0) {
        // After the constant band and the splat's step, a signed byte a number.
        uint first = uint(index - 1) * 3u;
        vec3 levels;
        for (uint channel = 0u; channel < 3u; channel++) {
            uint number = first + channel;
            uint word = sh_word(place, 2u + number / 4u);
            levels[channel] = float(int(word << (24u - 8u * (number & 3u))) >> 24);
        }
        return levels * half_at(place, 3u);
    }
#endif
    uint first = uint(index) * 3u;
    return vec3(half_at(place, first), half_at(place, first + 1u), half_at(place, first + 2u));
}
#endif
