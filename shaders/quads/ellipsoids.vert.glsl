// One page of the scene as ellipsoids, drawn with a depth test instead of a sort.
// Flags: QUADS_PER_INSTANCE, TINTS, and those of ellipsoid.
#include "quads/culled.glsl"
#include "common/ellipsoid.glsl"
#include "common/tint.glsl"
layout(std430, binding = 0) readonly buffer Positions { float positions[]; };
layout(std430, binding = 1) readonly buffer Quats { vec4 quats[]; };
layout(std430, binding = 2) readonly buffer Scales { vec4 scales_opacity[]; };
layout(std430, binding = 3) readonly buffer Colours { vec4 colours[]; };
layout(std430, binding = 4) readonly buffer DepthKeys { uint depth_keys[]; };
uniform uint u_page_first;
uniform uint u_page_count;

void main() {
    place_nothing();
    uint local = uint(gl_InstanceID) * uint(QUADS_PER_INSTANCE) + uint(gl_VertexID >> 2);
    uint splat = u_page_first + local;
    if (local >= u_page_count || depth_keys[splat] == CULLED) return;
    vec3 position = vec3(positions[3u * local], positions[3u * local + 1u], positions[3u * local + 2u]);
    vec4 scale_opacity = scales_opacity[local];
    Splat s = unedited(position, quats[local], scale_opacity.xyz, scale_opacity.w);
    place_ellipsoid(splat, s, tinted(splat, colours[splat].rgb));
}
