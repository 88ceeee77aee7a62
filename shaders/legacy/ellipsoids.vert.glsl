// The box that each ellipsoid covers on screen: quads/ellipsoids.vert.glsl for OpenGL 3.3, fetched from textures.
// Flags: TEXTURE_WIDTH, QUADS_PER_INSTANCE, ANTIALIASED (no effect on surfaces).
#include "legacy/texels.glsl"
#include "common/projection.glsl"
uniform sampler2D u_positions;  // xyz relative to the scene's centre, opacity
uniform sampler2D u_quats;
uniform sampler2D u_scales;
uniform sampler2D u_colours;    // of the projection; alpha is 0 where the splat is culled
uniform int u_splats;

flat out mat3 v_to_sphere;  // camera axes to the ellipsoid's own, where it is the unit sphere
flat out vec3 v_centre;     // the eye's offset to it, in those
flat out vec3 v_colour;

const float SIGMAS = 1.5;         // the surface drawn
const float LEAST_OPACITY = 0.2;  // fainter splats would hide the others
const float LEAST_PIXELS = 0.7;   // no axis thinner: it would shimmer

// Least and greatest x/z (or y/z) of the ellipsoid with centre (along, z) and rows `row`, `row_z` of its axes.
vec2 tangents(float along, float z, vec3 row, vec3 row_z) {
    float a = z * z - dot(row_z, row_z);
    float b = along * z - dot(row, row_z);
    float c = along * along - dot(row, row);
    float root = sqrt(max(b * b - a * c, 0.0));
    return (vec2(b) + vec2(-root, root)) / a;
}

void main() {
    uint splat = uint(gl_InstanceID) * uint(QUADS_PER_INSTANCE) + uint(gl_VertexID >> 2);
    gl_Position = vec4(0.0, 0.0, 0.0, 1.0);
    v_to_sphere = mat3(0.0);
    v_centre = v_colour = vec3(0.0);
    if (splat >= uint(u_splats)) return;
    ivec2 texel = texel_of(splat);
    vec4 colour = texelFetch(u_colours, texel, 0), position = texelFetch(u_positions, texel, 0);
    if (!(colour.a > 0.0) || !(position.w >= LEAST_OPACITY)) return;

    vec3 t = u_camera_from_world * ((position.xyz - u_eye_high) - u_eye_low);
    vec4 quat = texelFetch(u_quats, texel, 0);
    float largest = max(max(abs(quat.x), abs(quat.y)), max(abs(quat.z), abs(quat.w)));
    mat3 turned = u_camera_from_world * rotation_matrix(quat, largest);
    vec3 s = max(texelFetch(u_scales, texel, 0).xyz * SIGMAS, vec3(LEAST_PIXELS * t.z / u_focal.x));
    mat3 axes = mat3(turned[0] * s.x, turned[1] * s.y, turned[2] * s.z);
    vec3 row_x = vec3(axes[0].x, axes[1].x, axes[2].x);
    vec3 row_y = vec3(axes[0].y, axes[1].y, axes[2].y);
    vec3 row_z = vec3(axes[0].z, axes[1].z, axes[2].z);

    vec2 low = vec2(-1.0), high = u_size + 1.0;
    if (t.z * t.z > dot(row_z, row_z) * 1.01) {  // else it reaches the eye's plane: the whole image
        vec2 x = tangents(t.x, t.z, row_x, row_z), y = tangents(t.y, t.z, row_y, row_z);
        low = max(low, vec2(x.x, y.x) * u_focal + u_principal - 0.5);
        high = min(high, vec2(x.y, y.y) * u_focal + u_principal + 0.5);
        if (any(greaterThanEqual(low, high))) return;
    }
    v_to_sphere = transpose(mat3(turned[0] / s.x, turned[1] / s.y, turned[2] / s.z));
    v_centre = v_to_sphere * t;
    v_colour = colour.rgb;
    vec2 corner = vec2(gl_VertexID & 1, (gl_VertexID >> 1) & 1);
    gl_Position = vec4(mix(low, high, corner) / u_size * 2.0 - 1.0, 0.0, 1.0);
}
