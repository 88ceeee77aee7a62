// How pixels meet a disc: step 4d of scene/image_model.py, in the form of scene/discs.py.

const float DISC_LEAST_SLOPE = 1.0 / 1024.0;

uniform float u_sharpness;    // 1/px²: of the dot that a disc is at least
uniform float u_perspective;  // 1, or 0 where rays are parallel

// p of alpha = opacity·2^-p at a pixel `d` px from the projected mean. `rows` are u and v times the slope per
// px, in the unit that makes the exponent one of 2; `plane` is the slope at the mean, the lean per px and the
// most lean.
float disc_power(vec4 rows, vec4 plane, vec2 d) {
    float on_screen = u_sharpness * dot(d, d);
    float lean = dot(plane.yz, d), slope = plane.x + u_perspective * lean;
    vec2 uv = vec2(dot(rows.xy, d), dot(rows.zw, d)) / slope;
    bool is_met = slope >= DISC_LEAST_SLOPE;  // guard: least slope := bool is_met = slope >= -1.0;
    is_met = is_met && lean <= plane.w;       // guard: near plane
    return is_met ? min(dot(uv, uv), on_screen) : on_screen;
}
