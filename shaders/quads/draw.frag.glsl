// One splat at one pixel. The target holds the colour accumulated so far and, in alpha, the transmittance T:
// blended front to back by rgb += T·(alpha·colour), T *= 1 - alpha.
// Time on llvmpipe relative to this: alpha 0 in place of discard 0.98 (GPUs gain more from discarding),
// noperspective in place of flat inputs 1.00, boxes along the axes in place of the eigenvectors 1.00, a
// constant colour in place of all of main 0.74: most of it is reading and writing the target.
// Flags: POINTS, OVERDRAW (counts splats in place of blending them), STOCHASTIC (opaque, as often as alpha
// says; the nearest colour is then that of the blend on average. Enderton et al. 2010), WEIGHTED (sums
// in any order, nearer splats counting more; the blend adds colours and multiplies T. McGuire and Bavoil 2013),
// DISCS (splats are surfels).
#if HAS_DISCS
#include "common/surfel.glsl"
flat in vec4 v_rows;
flat in vec4 v_plane;
#endif
uniform float u_max_alpha;
uniform float u_brightest;  // greatest value of the target: infinity times a transmittance of 0 would be NaN

flat in vec4 v_shape;
flat in vec2 v_c_cut;
flat in vec4 v_colour;
layout(location = 0) out vec4 colour;
#if HAS_WEIGHTED
flat in float v_weight;
layout(location = 1) out vec4 weights;
#endif
#if HAS_STOCHASTIC
flat in uint v_splat;

// A number in [0, 1) of splat and pixel, always the same (pcg, Jarzynski and Olano 2020).
float chance(uint splat, uvec2 pixel) {
    uint state = splat;
    for (int i = 0; i < 3; i++) {
        if (i > 0) state ^= pixel[i - 1];
        state = state * 747796405u + 2891336453u;
        state = ((state >> ((state >> 28u) + 4u)) ^ state) * 277803737u;
        state = (state >> 22u) ^ state;
    }
    return float(state >> 8u) / 16777216.0;
}
#endif

void main() {
    vec2 d = gl_FragCoord.xy - v_shape.xy;
    float alpha;
    if (POINTS) {
        alpha = clamp(v_shape.z + 0.5 - length(d), 0.0, 1.0);
        if (!(alpha > 0.0)) discard;
    } else {
        vec2 whitened = vec2(v_shape.z * d.x + v_shape.w * d.y, v_c_cut.x * d.y);
        float power = dot(whitened, whitened);
#if HAS_DISCS
        if (DISCS) power = surfel_power(v_rows, v_plane, d);
#endif
        // Before min, which drivers may let turn NaN into its other argument: an opaque pixel.
        alpha = v_colour.a * exp2(-power);
        if (!(alpha >= v_c_cut.y)) discard;
        alpha = min(alpha, u_max_alpha);  // guard: cap of alpha
        if (!(alpha >= v_c_cut.y)) discard;
    }
    colour = OVERDRAW ? vec4(1.0, 0.0, 0.0, 0.0) : vec4(min(v_colour.rgb * alpha, u_brightest), alpha);
#if HAS_WEIGHTED
    if (WEIGHTED) {
        colour.rgb *= v_weight;
        weights = vec4(alpha * v_weight, 0.0, 0.0, alpha);
    }
#endif
#if HAS_STOCHASTIC
    if (STOCHASTIC) {
        if (!(chance(v_splat, uvec2(gl_FragCoord.xy)) < alpha)) discard;
        colour = vec4(min(v_colour.rgb, u_brightest), 0.0);  // opaque: the transmittance is 0
    }
#endif
}
