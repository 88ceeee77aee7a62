// The accumulated colour, composited over the background; alpha = 1 - T. Flags: DEPTH, OVERDRAW, WEIGHTED, and
// those of the background.
#include "common/background.glsl"
#include "common/colour_maps.glsl"
uniform sampler2D u_accumulation;  // rgb, T; with DEPTH sums of depth in r, with OVERDRAW the count of splats in r
uniform float u_brightest;     // greatest value of the picture
uniform vec2 u_depth_range;    // world units, near and far
uniform sampler2D u_weights;   // with WEIGHTED sums of alpha times weight in r
out vec4 colour;

const float MOST_OVERDRAW = 512.0;  // splats at one pixel that show as the map's last colour

void main() {
    vec4 accumulated = texelFetch(u_accumulation, ivec2(gl_FragCoord.xy), 0);
    float opacity = 1.0 - accumulated.a;
    if (WEIGHTED) accumulated.rgb *= opacity / max(texelFetch(u_weights, ivec2(gl_FragCoord.xy), 0).r, 1e-30);
    if (DEPTH) {
        // Expected depth: the mean over what the pixel shows, near bright and far dark.
        float depth = accumulated.r / max(opacity, 1e-6);
        float t = clamp((depth - u_depth_range.x) / (u_depth_range.y - u_depth_range.x), 0.0, 1.0);
        accumulated.rgb = viridis(1.0 - t) * opacity;
    } else if (OVERDRAW) {
        // Logarithmic: each doubling of the count is the same step of colour.
        float t = log2(1.0 + accumulated.r) / log2(1.0 + MOST_OVERDRAW);
        accumulated = vec4(inferno(min(t, 1.0)), 0.0);
        opacity = 1.0;
    }
    vec3 sum = accumulated.rgb + accumulated.a * background(gl_FragCoord.xy);
    colour = vec4(clamp(sum, -u_brightest, u_brightest), opacity);
}
