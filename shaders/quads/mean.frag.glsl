// One more picture into a running mean: blended by its share, alpha.
uniform sampler2D u_picture;
uniform float u_share;
out vec4 colour;

void main() { colour = vec4(texelFetch(u_picture, ivec2(gl_FragCoord.xy), 0).rgb, u_share); }
