// A flat splat's plane: steps 2d and 3d of scene/image_model.py, in the form of scene/discs.py.
#include "common/falloff.glsl"

const float DISC_LEAST_WIDTH = 1.0 / 64.0;  // px
const float LEAST_SCALE = 1.1754944e-38;    // world units: scales below are equal
const float LEAST_NEAR = 1e-6;              // world units
const float WIDEST = 1e15;                  // px
const float DISC_MOST_REACH = 1e30;         // standard deviations squared, where no alpha cut bounds a disc

struct Disc {
    vec4 rows;   // see common/disc.glsl
    vec4 plane;
};

// Of a splat at `t` with unit axes, all in camera axes. `m0` and `m1` are the rows of M: what is seen of
// u² + v² <= reach is within the ellipse of M·Mᵀ with that reach about the projected mean.
Disc disc_of(vec3 t, mat3 axes, vec3 scale, float reach, vec2 focal, float near, out vec3 m0, out vec3 m1) {
    vec3 size = max(scale, LEAST_SCALE);
    int normal = size.x < min(size.y, size.z) ? 0 : size.y < size.z ? 1 : 2;
    vec3 e_u = normal == 0 ? axes[1] : axes[0], e_v = normal == 2 ? axes[1] : axes[2];
    vec3 n = normal == 0 ? axes[0] : normal == 1 ? axes[1] : axes[2];
    vec3 r = ORTHOGRAPHIC ? vec3(0.0, 0.0, 1.0) : vec3(t.xy / t.z, 1.0);
    float away = ORTHOGRAPHIC ? 1.0 : t.z;
    vec2 s = vec2(normal == 0 ? scale.y : scale.x, normal == 2 ? scale.y : scale.z);
    s = max(s, DISC_LEAST_WIDTH * away / focal.x);
    near = max(near, LEAST_NEAR);

    float facing = dot(n, r);
    if (facing < 0.0) {
        facing = -facing;
        n = -n;
    }
    vec2 unit = ROOT_HALF_LOG2_E * away / s;
    float most_lean = ORTHOGRAPHIC ? facing * (t.z - near) : facing * (t.z / near - 1.0);
    Disc disc;
    disc.rows = vec4(
        cross(e_v, r).xy * unit.x / focal,
        cross(e_u, r).xy * unit.y / focal);
    disc.plane = vec4(facing, n.xy / focal, most_lean);

    // Of what is nearer than the mean an affine picture is too small, by t.z over its depth.
    vec2 lengths = s / away;
    if (!ORTHOGRAPHIC) {
        float least_depth = t.z - sqrt(reach) * length(vec2(e_u.z, e_v.z) * min(s, WIDEST));
        lengths *= t.z / max(least_depth, near);
    }
    m0 = vec3((e_u.x - r.x * e_u.z) * lengths.x, (e_v.x - r.x * e_v.z) * lengths.y, 0.0) * focal.x;
    m1 = vec3((e_u.y - r.y * e_u.z) * lengths.x, (e_v.y - r.y * e_v.z) * lengths.y, 0.0) * focal.y;
    vec3 entries = max(abs(m0), abs(m1));
    if (!is_finite(m0) || !is_finite(m1) || !(max(entries.x, entries.y) <= WIDEST)) {
        m0 = vec3(WIDEST, 0.0, 0.0);
        m1 = vec3(0.0, WIDEST, 0.0);
    }
    return disc;
}
