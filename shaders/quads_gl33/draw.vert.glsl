// quads/draw.vert.glsl for OpenGL 3.3: the same quads, fetched from textures.
// Flags: TEXTURE_WIDTH, QUADS_PER_INSTANCE, POINTS, DISCS, TINTS.
#include "common/texels.glsl"
#include "common/quad.glsl"
#include "common/tint.glsl"

uniform usampler2D u_order;    // splats, nearest first
uniform sampler2D u_shapes;
uniform sampler2D u_bounds;
uniform sampler2D u_colours;   // alpha is 0 where the splat is culled
#if HAS_DISCS
uniform sampler2D u_rows;
uniform sampler2D u_planes;
#endif
uniform int u_ordered;         // number of splats of `u_order` to draw

void main() {
    place_nothing();
    uint slot = uint(gl_InstanceID) * uint(QUADS_PER_INSTANCE) + uint(gl_VertexID >> 2);
    if (slot >= uint(u_ordered)) return;
    uint splat = texelFetch(u_order, texel_of(slot), 0).r;
    ivec2 texel = texel_of(splat);
    vec4 colour = texelFetch(u_colours, texel, 0);
    if (!(colour.a > 0.0)) return;
    place_quad(
        texelFetch(u_shapes, texel, 0),
        texelFetch(u_bounds, texel, 0),
        vec4(tinted(splat, colour.rgb), colour.a));
#if HAS_DISCS
    if (DISCS) {
        v_rows = texelFetch(u_rows, texel, 0);
        v_plane = texelFetch(u_planes, texel, 0);
    }
#endif
}
