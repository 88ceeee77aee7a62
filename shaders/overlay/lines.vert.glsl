// Lines in the picture, as quads: two triangles each, widened by a pixel for smooth edges.
uniform vec2 u_size;
in vec2 a_place;    // px
in float a_across;  // px from the line's middle
in vec4 a_colour;
out float v_across;
out vec4 v_colour;

void main() {
    v_across = a_across;
    v_colour = a_colour;
    gl_Position = vec4(a_place / u_size * 2.0 - 1.0, 0.0, 1.0);
}
