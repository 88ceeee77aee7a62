// quads/ellipsoids.vert.glsl for OpenGL 3.3: the same ellipsoids, fetched from textures.
// Flags: TEXTURE_WIDTH, QUADS_PER_INSTANCE, TINTS, and those of ellipsoid.
#include "common/texels.glsl"
#include "common/ellipsoid.glsl"
#include "common/tint.glsl"

uniform sampler2D u_positions;  // xyz relative to the scene's centre, opacity
uniform sampler2D u_quats;
uniform sampler2D u_scales;
uniform sampler2D u_colours;    // of the projection; alpha is 0 where the splat is culled
uniform int u_splats;

void main() {
    place_nothing();
    uint splat = uint(gl_InstanceID) * uint(QUADS_PER_INSTANCE) + uint(gl_VertexID >> 2);
    if (splat >= uint(u_splats)) return;
    ivec2 texel = texel_of(splat);
    vec4 colour = texelFetch(u_colours, texel, 0), position = texelFetch(u_positions, texel, 0);
    if (!(colour.a > 0.0)) return;
    vec4 quat = texelFetch(u_quats, texel, 0);
    Splat s = unedited(position.xyz, quat, texelFetch(u_scales, texel, 0).xyz, position.w);
    place_ellipsoid(splat, s, tinted(splat, colour.rgb));
}
