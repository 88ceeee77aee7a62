// One page of the scene as ellipsoids, drawn with a depth test instead of a sort.
// Flags: QUADS_PER_INSTANCE, TINTS, and those of attributes and ellipsoid.
#include "quads/culled.glsl"
#include "common/ellipsoid.glsl"
#include "common/tint.glsl"
#include "common/records.glsl"
#include "quads/attributes.glsl"
RECORDS_READ(3);
layout(std430, binding = 4) readonly buffer DepthKeys { uint depth_keys[]; };
uniform uint u_page_first;
uniform uint u_page_count;

void main() {
    place_nothing();
    uint local = uint(gl_InstanceID) * uint(QUADS_PER_INSTANCE) + uint(gl_VertexID >> 2);
    uint splat = u_page_first + local;
    if (local >= u_page_count || depth_keys[splat] == CULLED) return;
    vec4 scale_opacity = scale_opacity_of(local);
    Splat s = unedited(position_of(local), quat_of(local), scale_opacity.xyz, scale_opacity.w);
    place_ellipsoid(splat, s, tinted(splat, RECORD(colours, splat).rgb));
}
