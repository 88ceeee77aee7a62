// One splat at one pixel. The target holds the colour gathered so far and, in alpha, the transmittance T:
// blended front to back by rgb += T·(alpha·colour), T *= 1 - alpha. Flags: POINTS, ELLIPSOIDS, OVERDRAW,
// at most one of them 1 (depth is drawn as splats whose colour is their depth).
uniform float u_alpha_cut;
uniform float u_max_alpha;

flat in vec4 v_shape;
flat in float v_c;
flat in vec4 v_colour;
out vec4 colour;

const float POINT_RADIUS = 1.5;         // px
const float LN_2 = 0.69314718055994531;

void main() {
    vec2 d = gl_FragCoord.xy - v_shape.xy;
    vec2 whitened = vec2(v_shape.z * d.x + v_shape.w * d.y, v_c * d.y);
    float power = dot(whitened, whitened);  // alpha is opacity·2^-power
#if POINTS
    if (!(dot(d, d) <= POINT_RADIUS * POINT_RADIUS)) discard;
    colour = vec4(v_colour.rgb, 1.0);
#elif ELLIPSOIDS
    // The shell at one standard deviation, lit from the eye.
    float q = 2.0 * LN_2 * power;
    if (!(q <= 1.0)) discard;
    colour = vec4(v_colour.rgb * (0.5 + 0.5 * sqrt(1.0 - q)), 1.0);
#else
    float alpha = min(v_colour.a * exp2(-power), u_max_alpha);
    if (!(alpha >= u_alpha_cut)) discard;
#if OVERDRAW
    colour = vec4(1.0);
#else
    colour = vec4(v_colour.rgb * alpha, alpha);
#endif
#endif
}
