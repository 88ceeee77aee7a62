// Flag: RINGS.
uniform float u_radius;  // px
flat in vec3 v_colour;
flat in vec2 v_mean;
flat in vec3 v_conic;
out vec4 colour;

void main() {
    vec2 d = gl_FragCoord.xy - v_mean;
    float apart;
    if (RINGS) {
        // Distance from the ellipse to first order: (length - 1) over the gradient of the length.
        vec2 whitened = vec2(v_conic.x * d.x + v_conic.y * d.y, v_conic.z * d.y);
        float q = length(whitened);
        vec2 gradient = vec2(v_conic.x * whitened.x, v_conic.y * whitened.x + v_conic.z * whitened.y) / max(q, 1e-6);
        apart = abs(q - 1.0) / max(length(gradient), 1e-9);
    } else {
        apart = length(d);
    }
    if (!(apart <= u_radius)) discard;
    colour = vec4(v_colour, 1.0);
}
