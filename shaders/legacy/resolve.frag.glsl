// The gathered colour over the background; alpha = 1 - T.
uniform sampler2D u_gathered;  // rgb, T
uniform vec3 u_background;
out vec4 colour;

void main() {
    vec4 gathered = texelFetch(u_gathered, ivec2(gl_FragCoord.xy), 0);
    colour = vec4(gathered.rgb + gathered.a * u_background, 1.0 - gathered.a);
}
