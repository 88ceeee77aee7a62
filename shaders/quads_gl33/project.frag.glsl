// One fragment per splat: footprint and colour, into textures that the draw fetches from. A culled splat
// is discarded: its texels stay 0, and the query of samples passed counts the others.
// Flags: TEXTURE_WIDTH, SH_DEGREE, OWN_DEGREES (see u_sh), ANTIALIASED, DEPTH and NORMALS (in place of the
// colour), and those of edits.
#include "common/texels.glsl"
#include "common/edits.glsl"
#include "common/normal.glsl"
#include "common/sh.glsl"

uniform sampler2D u_positions;  // xyz relative to the scene's centre, opacity
uniform sampler2D u_quats;      // wxyz, raw
uniform sampler2D u_scales;     // standard deviations
uniform sampler2DArray u_sh;    // one layer per coefficient; with OWN_DEGREES one coefficient after the other
#if HAS_OWN_DEGREES
uniform usampler2D u_places;    // where a splat's coefficients begin, times four, plus its degree
uniform int u_sh_layer;         // texels of one layer
#endif
#if HAS_WIDE
uniform sampler2D u_rests;      // positions less their float32 rounding
#endif
uniform int u_splats;

layout(location = 0) out vec4 shape;   // mean.xy, a, b
layout(location = 1) out vec4 bounds;  // c, minor axis, major axis.xy
layout(location = 2) out vec4 colour;  // rgb, opacity
#if HAS_DISCS
layout(location = 3) out vec4 rows;    // see common/surfel.glsl
layout(location = 4) out vec4 plane;
#endif

#if HAS_OWN_DEGREES
uint sh_place(uint splat) { return texelFetch(u_places, texel_of(splat), 0).r; }
int sh_own_degree(uint place) { return int(place & 3u); }
vec3 sh_coefficient(uint place, int index) {
    uint at = (place >> 2u) + uint(index), layer = at / uint(u_sh_layer);
    return texelFetch(u_sh, ivec3(texel_of(at - layer * uint(u_sh_layer)), layer), 0).rgb;
}
#else
uint sh_place(uint splat) { return splat; }
int sh_own_degree(uint place) { return 3; }
vec3 sh_coefficient(uint place, int index) { return texelFetch(u_sh, ivec3(texel_of(place), index), 0).rgb; }
#endif

void main() {
    ivec2 texel = ivec2(gl_FragCoord.xy);
    uint splat = uint(texel.y) * uint(TEXTURE_WIDTH) + uint(texel.x);
    if (splat >= uint(u_splats)) discard;
    vec4 position = texelFetch(u_positions, texel, 0);
    vec4 quat = texelFetch(u_quats, texel, 0);
    Splat s = unedited(position.xyz, quat, texelFetch(u_scales, texel, 0).xyz, position.w);
#if HAS_WIDE
    if (WIDE) s.offset += texelFetch(u_rests, texel, 0).xyz;
#endif
    Footprint f;
    if (!edit(splat, s) || !project(s.offset, s.quat, s.scale, s.opacity, f)) discard;
    vec3 rgb = graded(splat, sh_colour(splat, harmonics_direction(splat, f.direction)));
    if (!is_finite(rgb)) discard;
    if (NORMALS) rgb = normal_colour(s);
    if (DEPTH) rgb = vec3(f.depth);
    shape = vec4(f.mean, f.conic.xy);
    bounds = vec4(f.conic.z, f.minor_axis, f.major_axis);
    colour = vec4(max(rgb, vec3(0.0)), f.opacity);
#if HAS_DISCS
    rows = DISCS ? f.surfel.rows : vec4(0.0);
    plane = DISCS ? f.surfel.plane : vec4(0.0);
#endif
}
