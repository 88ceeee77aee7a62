// A surfel's plane and bounds: steps 2d and 3d of scene/image_model.py, in the form of scene/surfels.py.
#include "common/falloff.glsl"

const float SURFEL_LEAST_WIDTH = 1.0 / 64.0;  // px
const float LEAST_SCALE = 1.1754944e-38;    // world units: scales below are equal
const float LEAST_NEAR = 1e-6;              // world units
const float WIDEST = 1e15;                  // px
const float UNBOUNDED_RADIUS_SQUARED = 1e30;         // standard deviations squared, where no alpha cut bounds a surfel

struct Surfel {
    vec4 rows;   // see common/surfel.glsl
    vec4 plane;
};

const float NO_BOUND = 1e30;
const float STRONG = 1.5;  // factor by which a surfel's near side is closer than its mean from which on a box may be smaller

// Least and greatest x/z (or y/z) of the part before the eye of a surfel at (along, z) with scaled axes `a`, two
// numbers along and two in z: where the planes along = k·z touch it. A little wide, and without bound where
// the surfel crosses the eye's plane or float32 cannot tell.
vec2 visible_range(float along, float z, vec2 a, vec2 a_z, float radius_squared) {
    vec2 unbounded = vec2(-NO_BOUND, NO_BOUND), largest = max(abs(a), abs(a_z));
    float unit = max(max(abs(along), z), max(largest.x, largest.y));
    along /= unit;
    z /= unit;
    a /= unit;
    a_z /= unit;
    float p = z * z - radius_squared * dot(a_z, a_z), most = z * z + radius_squared * dot(a_z, a_z);
    float q = along * z - radius_squared * dot(a, a_z), r = along * along - radius_squared * dot(a, a);
    float cross_terms = abs(along * z) + radius_squared * dot(abs(a), abs(a_z));
    float terms = cross_terms * cross_terms + most * (along * along + radius_squared * dot(a, a));
    if (!(terms < NO_BOUND) || !(abs(p) >= 0.02 * most)) return unbounded;
    float inside = q * q - p * r, root = sqrt(max(inside, 0.0));
    float slack = 2e-3 * sqrt(terms) / abs(p);  // the root of a rounding
    vec2 roots = (vec2(q) + vec2(-root, root)) / p;
    if (p > 0.0) return roots + vec2(-slack, slack);
    if (!(inside > 1e-5 * terms)) return unbounded;
    // The part before the eye is on the mean's side.
    return along >= z * 0.5 * (roots.x + roots.y) ? vec2(max(roots.x, roots.y) - slack, NO_BOUND)
                                                  : vec2(-NO_BOUND, min(roots.x, roots.y) + slack);
}

// Half extent, px, from the mean of the part within `range` and the picture; less than 0 where there is none.
float half_box(vec2 range, float focal, float centre, float size, float mean, float dot_radius) {
    float first = max(range.x * focal + centre - dot_radius, 0.0);
    float last = min(range.y * focal + centre + dot_radius, size);
    return last < first ? -1.0 : max(max(last - mean, mean - first), dot_radius);
}

// The surfel of a splat at `t` with unit axes, all in camera axes. `m0` and `m1` are the rows of M: the visible
// part of u² + v² <= radius_squared is within the ellipse of M·Mᵀ with that radius about the projected mean. False
// where the
// picture sees none of it.
bool surfel_of(vec3 t, mat3 axes, vec3 scale, float radius_squared, out Surfel surfel, out vec3 m0, out vec3 m1) {
    vec3 size = max(scale, LEAST_SCALE);
    int normal = size.x < min(size.y, size.z) ? 0 : size.y < size.z ? 1 : 2;
    vec3 e_u = normal == 0 ? axes[1] : axes[0], e_v = normal == 2 ? axes[1] : axes[2];
    vec3 n = normal == 0 ? axes[0] : normal == 1 ? axes[1] : axes[2];
    vec3 r = ORTHOGRAPHIC ? vec3(0.0, 0.0, 1.0) : vec3(quotient(t.xy, t.z), 1.0);
    float away = ORTHOGRAPHIC ? 1.0 : t.z;
    vec2 s = vec2(normal == 0 ? scale.y : scale.x, normal == 2 ? scale.y : scale.z);
    s = max(s, SURFEL_LEAST_WIDTH * away / u_focal.x);  // guard: least width
    float near = max(u_near, LEAST_NEAR);

    float normal_dot_ray = dot(n, r);
    if (normal_dot_ray < 0.0) {
        normal_dot_ray = -normal_dot_ray;
        n = -n;
    }
    vec2 unit = ROOT_HALF_LOG2_E * away / s;
    float greatest_change = ORTHOGRAPHIC ? normal_dot_ray * (t.z - near) : normal_dot_ray * (t.z / near - 1.0);
    surfel.rows = vec4(
        cross(e_v, r).xy * unit.x / u_focal,
        cross(e_u, r).xy * unit.y / u_focal);
    surfel.plane = vec4(normal_dot_ray, n.xy / u_focal, greatest_change);

    // An affine picture of the part nearer than the mean is too small, by t.z over its depth.
    vec2 lengths = quotient(s, away);
    float growth = 1.0;
    if (!ORTHOGRAPHIC) {
        float least_depth = t.z - sqrt(radius_squared) * length(vec2(e_u.z, e_v.z) * min(s, WIDEST));
        growth = t.z / max(least_depth, near);
        lengths *= growth;
    }
    m0 = vec3((e_u.x - r.x * e_u.z) * lengths.x, (e_v.x - r.x * e_v.z) * lengths.y, 0.0) * u_focal.x;
    m1 = vec3((e_u.y - r.y * e_u.z) * lengths.x, (e_v.y - r.y * e_v.z) * lengths.y, 0.0) * u_focal.y;
    if (growth >= STRONG && radius_squared < UNBOUNDED_RADIUS_SQUARED) {
        // That ellipse can be far too large: one around a box then, as far as it is in the picture.
        vec2 mean = r.xy * u_focal + u_principal, a_z = vec2(e_u.z, e_v.z) * s;
        vec2 x = visible_range(t.x, t.z, vec2(e_u.x, e_v.x) * s, a_z, radius_squared);
        vec2 y = visible_range(t.y, t.z, vec2(e_u.y, e_v.y) * s, a_z, radius_squared);
        float dot_radius = sqrt(radius_squared * u_blur) + 0.02;
        vec2 half_size = vec2(
            half_box(x, u_focal.x, u_principal.x, u_size.x, mean.x, dot_radius),
            half_box(y, u_focal.y, u_principal.y, u_size.y, mean.y, dot_radius));
        if (half_size.x < 0.0 || half_size.y < 0.0) return false;
        if (!(2.0 * half_size.x * half_size.y >= abs(m0.x * m1.y - m0.y * m1.x) * radius_squared)) {
            half_size *= sqrt(2.0 / radius_squared);
            m0 = vec3(half_size.x, 0.0, 0.0);
            m1 = vec3(0.0, half_size.y, 0.0);
        }
    }
    vec3 entries = max(abs(m0), abs(m1));
    // guard: widest ellipse := if (false) {
    if (!is_finite(m0) || !is_finite(m1) || !(max(entries.x, entries.y) <= WIDEST)) {
        m0 = vec3(WIDEST, 0.0, 0.0);
        m1 = vec3(0.0, WIDEST, 0.0);
    }
    return true;
}
