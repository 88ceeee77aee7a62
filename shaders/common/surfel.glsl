// Alpha of a surfel at a pixel: step 4d of scene/image_model.py, in the form of scene/surfels.py.

const float SURFEL_LEAST_SLOPE = 1.0 / 1024.0;

uniform float u_sharpness;    // 1/px²: of the dot that a surfel covers at least
uniform float u_perspective;  // 1, or 0 where rays are parallel

// p of alpha = opacity·2^-p at a pixel `d` px from the projected mean. `rows` are u and v times the slope per
// px, in the unit that makes the exponent one of 2; `plane` is normal·ray at the mean, its change per px, and the
// greatest change before the near plane.
float surfel_power(vec4 rows, vec4 plane, vec2 d) {
    float on_screen = u_sharpness * dot(d, d);
    float change = dot(plane.yz, d), slope = plane.x + u_perspective * change;
    vec2 uv = vec2(dot(rows.xy, d), dot(rows.zw, d)) / slope;
    bool on_plane = slope >= SURFEL_LEAST_SLOPE;  // guard: least slope := bool on_plane = slope >= -1.0;
    on_plane = on_plane && change <= plane.w;       // guard: near plane
    return on_plane ? min(dot(uv, uv), on_screen) : on_screen;
}
