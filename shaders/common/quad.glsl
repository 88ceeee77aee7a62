// The quad that one splat covers on screen, and what its fragments need. Row 0 of the target is the
// picture's top row. Flags: POINTS (dots of one size), DISCS (surfels: a and b are of an ellipse around them).
#include "common/falloff.glsl"
#include "common/numbers.glsl"

uniform vec2 u_size;
uniform float u_alpha_cut;
uniform float u_least_share;  // share of its opacity below which a splat's alpha is 0, too

flat out vec4 v_shape;    // mean.xy px, then a, b in the unit that makes the exponent one of 2
flat out vec2 v_c_cut;    // c, and the alpha below which there is none
flat out vec4 v_colour;   // rgb, opacity
#if HAS_DISCS
flat out vec4 v_rows;     // see common/surfel.glsl
flat out vec4 v_plane;
#endif

const float POINT_RADIUS = 1.6;                      // px
const float LARGE = 2048.0;                           // px; beyond it the rasteriser's fixed point suffers

// All four vertices: no area.
void place_nothing() {
    gl_Position = vec4(0.0, 0.0, 0.0, 1.0);
    v_shape = v_colour = vec4(0.0);
    v_c_cut = vec2(0.0);
#if HAS_DISCS
    v_rows = v_plane = vec4(0.0);
#endif
}

// Places vertex gl_VertexID % 4. `shape` is mean.xy, a, b; `bound` is c, minor axis, major axis.xy.
void place_quad(vec4 shape, vec4 bound, vec4 colour) {
    v_shape = vec4(shape.xy, shape.zw * ROOT_HALF_LOG2_E);
    v_c_cut = vec2(bound.x * ROOT_HALF_LOG2_E, max(u_alpha_cut, u_least_share * colour.a));
    v_colour = colour;
#if HAS_DISCS
    v_rows = v_plane = vec4(0.0);
#endif
    vec2 corner = vec2(gl_VertexID & 1, (gl_VertexID >> 1) & 1) * 2.0 - 1.0;
    vec2 major = bound.zw;
    float major_length = hypotenuse(major.xx, major.yy).x;
    vec2 along = quotient(major, major_length);
    vec2 minor = bound.y * vec2(-along.y, along.x);
    vec2 position;
    if (POINTS) {
        v_shape.zw = vec2(POINT_RADIUS);
        position = shape.xy + corner * (POINT_RADIUS + 1.0);
    } else if (major_length <= LARGE) {
        // 1/64 px wider: vertices snap to 1/256 px and must not lose a pixel on the edge.
        position = shape.xy + corner.x * (major + along / 64.0) + corner.y * (minor + vec2(-along.y, along.x) / 64.0);
    } else {
        vec2 extent = hypotenuse(major, minor) + 0.02;
        position = clamp(shape.xy + corner * extent, vec2(-1.0), u_size + 1.0);
    }
    gl_Position = vec4(position / u_size * 2.0 - 1.0, 0.0, 1.0);
}
