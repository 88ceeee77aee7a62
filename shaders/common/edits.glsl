// A splat after its edits, by scene/edits.py: unchanged, at no cost, where no flag is set.
// Flags: HIDES (some splats are hidden or deleted, or crops leave them alone), ADJUSTS (some have an adjustment),
// CROPS, ROW_TEXELS and CROP_TEXELS (of a row), and those of marks.
#include "common/projection.glsl"
#include "common/marks.glsl"

struct Splat {
    vec3 position;  // relative to the scene's centre
    vec3 offset;    // from the eye
    vec4 quat;      // wxyz, raw
    vec3 scale;     // standard deviations
    float opacity;
};

Splat unedited(vec3 position, vec4 quat, vec3 scale, float opacity) {
    return Splat(position, from_eye(position), quat, scale, opacity);
}

uniform sampler2D u_palette;       // table of scene/edits.py, in texels of four numbers
uniform uint u_last_adjustment;


// Palette index of `splat`, 0 for the identity. Marks may be newer than the palette.
uint adjustment_of(uint splat) { return min(mark_of(splat) >> uint(PALETTE_SHIFT), u_last_adjustment); }

vec4 palette_texel(uint entry, uint index) {
    return texelFetch(u_palette, texel_of(entry * uint(ROW_TEXELS) + index), 0);
}

vec4 quat_product(vec4 p, vec4 q) {
    return vec4(p.x * q.x - dot(p.yzw, q.yzw), p.x * q.yzw + q.x * p.yzw + cross(p.yzw, q.yzw));
}

void adjust(uint entry, inout Splat s) {
    vec4 x = palette_texel(entry, 0u), y = palette_texel(entry, 1u), z = palette_texel(entry, 2u);
    vec3 rotated = vec3(dot(x.xyz, s.position), dot(y.xyz, s.position), dot(z.xyz, s.position));
    vec3 shift = vec3(x.w, y.w, z.w);
    vec4 rest = palette_texel(entry, 8u);  // factor on scales; the digits that `shift` lost in float32
    s.position = rotated + shift;
    // Not from `position`: eye and shift may both be far off, and what they share cancels exactly.
    s.offset = (rotated + (shift - u_eye_high)) + (rest.yzw - u_eye_low);
    s.quat = quat_product(palette_texel(entry, 3u), s.quat);
    s.scale *= rest.x;
    vec4 map = palette_texel(entry, 7u);  // gain, offset, low, high
    if (is_finite(s.opacity)) s.opacity = clamp(map.x * s.opacity + map.y, map.z, map.w);
}

uniform sampler2D u_crops;  // table of scene/edits.py, in texels of four numbers
uniform uint u_crop_count;

vec4 crop_texel(uint crop, uint index) { return texelFetch(u_crops, texel_of(crop * uint(CROP_TEXELS) + index), 0); }

// Whether a position is in any crop that keeps its inside (if there is one), and in none that removes it.
bool is_cropped_in(vec3 position) {
    bool keeps = false, kept = false;
    for (uint crop = 0u; crop < u_crop_count; crop++) {
        vec4 v = vec4(position, 1.0);
        vec3 own = vec3(dot(crop_texel(crop, 0u), v), dot(crop_texel(crop, 1u), v), dot(crop_texel(crop, 2u), v));
        vec4 kind = crop_texel(crop, 3u);  // is a sphere, keeps its inside
        bool inside = kind.x > 0.5 ? dot(own, own) <= 1.0 : all(lessThanEqual(abs(own), vec3(1.0)));
        if (kind.y > 0.5) {
            keeps = true;
            kept = kept || inside;
        } else if (inside) {
            return false;
        }
    }
    return kept || !keeps;
}

// Applies the edits to an unedited splat; false where they hide it.
bool edit(uint splat, inout Splat s) {
    bool uncropped = false;
    if (HIDES) {
        uint mark = mark_of(splat);
        if ((mark & uint(NOT_SHOWN)) != 0u) return false;
        uncropped = (mark & uint(FILE_LOCKED)) != 0u;
    }
    if (ADJUSTS) {
        uint entry = adjustment_of(splat);
        if (entry != 0u) adjust(entry, s);
    }
    if (CROPS && !uncropped && !is_cropped_in(s.position)) return false;
    return true;
}

// The direction in which the file's harmonics of `splat` are to be looked up.
vec3 harmonics_direction(uint splat, vec3 direction) {
    if (!ADJUSTS) return direction;
    uint entry = adjustment_of(splat);
    return entry != 0u ? direction * rotation_matrix(palette_texel(entry, 3u), 1.0) : direction;
}

vec3 graded(uint splat, vec3 rgb) {
    if (!ADJUSTS) return rgb;
    uint entry = adjustment_of(splat);
    if (entry == 0u) return rgb;
    vec4 v = vec4(rgb, 1.0);
    return vec3(
        dot(palette_texel(entry, 4u), v), dot(palette_texel(entry, 5u), v), dot(palette_texel(entry, 6u), v));
}
