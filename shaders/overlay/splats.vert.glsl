// Centre or outline of one splat, four vertices each: the ellipse of one standard deviation as projection has it.
// Flags: RINGS (outlines, in place of centres), and those of edits, projection and tints.
#include "common/edits.glsl"
#include "common/tint.glsl"
uniform float u_radius;      // px, of a centre; half a ring's width
uniform float u_depth_unit;  // world units; depths about it keep the most digits
uniform vec3 u_centre_colour;
uniform uint u_first;  // splat of the first instance
in vec4 a_position;  // relative to the scene's centre, opacity
in vec4 a_quat;
in vec3 a_scale;     // standard deviations
in vec3 a_colour;
flat out vec3 v_colour;
flat out vec2 v_mean;   // px
flat out vec3 v_conic;  // whitens an offset in px: length 1 on the ellipse

void main() {
    gl_Position = vec4(0.0, 0.0, 0.0, 1.0);
    v_colour = v_conic = vec3(0.0);
    v_mean = vec2(0.0);
    uint splat = u_first + uint(gl_InstanceID);
    Splat s = unedited(a_position.xyz, a_quat, a_scale, a_position.w);
    Footprint f;
    if (!edit(splat, s) || !project(s.offset, s.quat, s.scale, s.opacity, f)) return;
    v_mean = f.mean;
    v_conic = f.conic;
    v_colour = tinted(splat, RINGS ? mix(a_colour, vec3(1.0), 0.3) : u_centre_colour);
    // The conic q = (a x + b y)² + (c y)² reaches 1 at these offsets.
    vec2 reach = vec2(length(vec2(f.conic.y, f.conic.z)) / (f.conic.x * f.conic.z), 1.0 / f.conic.z);
    vec2 extent = RINGS ? min(reach, 4.0 * u_size) + u_radius + 1.0 : vec2(u_radius + 1.0);
    vec2 corner = vec2(gl_VertexID & 1, (gl_VertexID >> 1) & 1) * 2.0 - 1.0;
    vec2 place = clamp(f.mean + corner * extent, vec2(-1.0), u_size + 1.0);
    float z = f.depth / (f.depth + u_depth_unit) * 2.0 - 1.0;
    gl_Position = vec4(place / u_size * 2.0 - 1.0, z, 1.0);
}
