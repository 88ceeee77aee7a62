// Lines behind what the picture shows: only so much of them is seen as the scene lets through, and a little more.
uniform sampler2D u_picture;
uniform vec2 u_size;
uniform float u_half_width;  // px
uniform float u_shows_through;  // share that is seen through what is opaque
in float v_across;
in vec4 v_colour;
out vec4 colour;

void main() {
    float covered = clamp(texture(u_picture, gl_FragCoord.xy / u_size).a, 0.0, 1.0);
    float edge = clamp(u_half_width + 0.5 - abs(v_across), 0.0, 1.0);
    float alpha = v_colour.a * edge * mix(1.0, u_shows_through, covered);
    if (!(alpha > 0.0)) discard;
    colour = vec4(v_colour.rgb, alpha);
}
