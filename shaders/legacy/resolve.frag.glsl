// What was gathered, over the background; alpha = 1 - T. Flags: DEPTH, OVERDRAW.
#include "legacy/ramp.glsl"

uniform sampler2D u_gathered;  // rgb, T; depth: its mean weighted with alpha·T; overdraw: a count
uniform vec3 u_background;
out vec4 colour;

const float FULL_HEAT = 8.0;  // log2 of how many splats on a pixel are the hottest colour

void main() {
    vec4 gathered = texelFetch(u_gathered, ivec2(gl_FragCoord.xy), 0);
#if OVERDRAW
    colour = vec4(ramp(log2(1.0 + gathered.r) / FULL_HEAT), 1.0);
#else
#if DEPTH
    float covered = 1.0 - gathered.a;
    // Near is light.
    gathered.rgb = covered > 0.0 ? covered * ramp(1.0 - gathered.r / covered) : vec3(0.0);
#endif
    colour = vec4(gathered.rgb + gathered.a * u_background, 1.0 - gathered.a);
#endif
}
