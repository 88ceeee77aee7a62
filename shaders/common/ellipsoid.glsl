// The box that one ellipsoid covers on screen, and what its fragments need.
// Flags: those of edits and projection; ANTIALIASED has no effect on surfaces, and LENS is not supported.
#include "common/edits.glsl"

flat out mat3 v_to_sphere;  // camera axes to the ellipsoid's own, where it is the unit sphere
flat out vec3 v_centre;     // its centre as the eye sees it, in those
flat out vec3 v_colour;

const float SIGMAS = 1.5;         // the surface drawn
const float LEAST_OPACITY = 0.2;  // fainter splats would hide the others
const float LEAST_PIXELS = 0.7;   // no axis thinner: it would shimmer

// All four vertices: no area.
void place_nothing() {
    gl_Position = vec4(0.0, 0.0, 0.0, 1.0);
    v_to_sphere = mat3(0.0);
    v_centre = v_colour = vec3(0.0);
}

// Least and greatest x/z (or y/z) of the ellipsoid with centre (along, z) and rows `row`, `row_z` of its axes.
vec2 tangents(float along, float z, vec3 row, vec3 row_z) {
    float a = z * z - dot(row_z, row_z);
    float b = along * z - dot(row, row_z);
    float c = along * along - dot(row, row);
    float root = sqrt(max(b * b - a * c, 0.0));
    return (vec2(b) + vec2(-root, root)) / a;
}

// Places vertex gl_VertexID % 4 of a splat that projection did not cull.
void place_ellipsoid(uint splat, Splat s, vec3 colour) {
    if (!edit(splat, s) || !(s.opacity >= LEAST_OPACITY)) return;
    vec3 t = u_camera_from_world * s.offset;
    float largest = max(max(abs(s.quat.x), abs(s.quat.y)), max(abs(s.quat.z), abs(s.quat.w)));
    mat3 rotated = u_camera_from_world * rotation_matrix(s.quat, largest);
    float pixel = (ORTHOGRAPHIC ? 1.0 : t.z) / u_focal.x;
    vec3 half_axes = max(s.scale * SIGMAS, vec3(LEAST_PIXELS * pixel));
    mat3 axes = mat3(rotated[0] * half_axes.x, rotated[1] * half_axes.y, rotated[2] * half_axes.z);
    vec3 row_x = vec3(axes[0].x, axes[1].x, axes[2].x);
    vec3 row_y = vec3(axes[0].y, axes[1].y, axes[2].y);
    vec3 row_z = vec3(axes[0].z, axes[1].z, axes[2].z);

    vec2 low = vec2(-1.0), high = u_size + 1.0;
    if (ORTHOGRAPHIC) {
        vec2 extent = vec2(length(row_x), length(row_y));
        low = max(low, (t.xy - extent) * u_focal + u_principal - 0.5);
        high = min(high, (t.xy + extent) * u_focal + u_principal + 0.5);
        if (any(greaterThanEqual(low, high))) return;
    } else if (t.z * t.z > dot(row_z, row_z) * 1.01) {  // else it reaches the eye's plane: the whole image
        vec2 x = tangents(t.x, t.z, row_x, row_z), y = tangents(t.y, t.z, row_y, row_z);
        low = max(low, vec2(x.x, y.x) * u_focal + u_principal - 0.5);
        high = min(high, vec2(x.y, y.y) * u_focal + u_principal + 0.5);
        if (any(greaterThanEqual(low, high))) return;
    }
    v_to_sphere = transpose(mat3(rotated[0] / half_axes.x, rotated[1] / half_axes.y, rotated[2] / half_axes.z));
    v_centre = v_to_sphere * t;
    v_colour = colour;
    vec2 corner = vec2(gl_VertexID & 1, (gl_VertexID >> 1) & 1);
    gl_Position = vec4(mix(low, high, corner) / u_size * 2.0 - 1.0, 0.0, 1.0);
}
