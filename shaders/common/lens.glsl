// Where a lens puts the ray (u, v) = t.xy / t.z, and the derivative of that: scene/lens_formula.py.

uniform vec2 u_lens_bend;     // slope (0: no fisheye) and unit
uniform vec2 u_lens_unified;  // alpha (0: no unified camera) and beta
uniform vec3 u_lens_stretch;  // n1, n2, n3
uniform vec3 u_lens_higher;   // n4, n5, n6
uniform vec3 u_lens_divide;   // d1, d2, d3
uniform vec2 u_lens_skew;     // p1, p2
uniform vec4 u_lens_prism;    // s1, s2, s3, s4
uniform bool u_lens_skew_last;
uniform float u_lens_reach;   // greatest r² that the lens maps, or the largest number

const float LEAST_RADIUS_SQUARED = 1e-16, LEAST_RHO_SQUARED = 1e-5;
const float LEAST_BEND = 0.41421356, MOST_BEND = 2.41421356;  // tan of 22.5 and 67.5 degrees

// The angle of a slope that is at least 0, to 1e-7: drivers may be off by 2e-4, a tenth of a pixel.
float lens_angle(float slope) {
    float y = slope, before = 0.0;
    if (slope > MOST_BEND) {
        y = -1.0 / slope;
        before = 1.57079633;
    } else if (slope > LEAST_BEND) {
        y = (slope - 1.0) / (slope + 1.0);
        before = 0.78539816;
    }
    float q = y * y;  // atan(y) / y on [0, LEAST_BEND²], Chebyshev interpolation
    return before + y * (0.9999999994 + q * (-0.3333330689 + q * (0.1999818304
        + q * (-0.1423953267 + q * (0.1056982879 + q * -0.0602631371)))));
}

// r, and the magnifications across and along the radius.
vec3 lens_magnifications(vec2 ray) {
    float rr = max(dot(ray, ray), LEAST_RADIUS_SQUARED), r = sqrt(rr), slope = u_lens_bend.x;
    if (slope > 0.0)
        return vec3(r, lens_angle(slope * r) / (u_lens_bend.y * r), slope / (u_lens_bend.y * (1.0 + slope * slope * rr)));
    float alpha = u_lens_unified.x;
    if (!(alpha > 0.0)) return vec3(r, 1.0, 1.0);
    float rho = sqrt(max(1.0 + u_lens_unified.y * rr, LEAST_RHO_SQUARED));
    float g = 1.0 / (1.0 - alpha + alpha * rho);
    return vec3(r, g, g * g * (1.0 - alpha + alpha / rho));
}

// N / D and its derivative by q.
vec2 lens_stretch(float q) {
    vec3 n = u_lens_stretch, h = u_lens_higher, d = u_lens_divide;
    float above = 1.0 + q * (n.x + q * (n.y + q * (n.z + q * (h.x + q * (h.y + q * h.z)))));
    float above_1 = n.x + q * (2.0 * n.y + q * (3.0 * n.z + q * (4.0 * h.x + q * (5.0 * h.y + q * (6.0 * h.z)))));
    float inverse = 1.0 / (1.0 + q * (d.x + q * (d.y + q * d.z)));
    float ratio = above * inverse;
    return vec2(ratio, (above_1 - ratio * (d.x + q * (2.0 * d.y + q * (3.0 * d.z)))) * inverse);
}

vec2 lens_skew(vec2 w) {
    float q = dot(w, w), p1 = u_lens_skew.x, p2 = u_lens_skew.y;
    return vec2(
        2.0 * p1 * w.x * w.y + p2 * (q + 2.0 * w.x * w.x) + q * (u_lens_prism.x + u_lens_prism.y * q),
        2.0 * p2 * w.x * w.y + p1 * (q + 2.0 * w.y * w.y) + q * (u_lens_prism.z + u_lens_prism.w * q));
}

// 2x2 derivatives, here and below: the columns are by x and by y.
mat2 lens_skew_jacobian(vec2 w) {
    float q = dot(w, w), p1 = u_lens_skew.x, p2 = u_lens_skew.y;
    vec2 prism = 2.0 * (u_lens_prism.xz + 2.0 * q * u_lens_prism.yw);
    return mat2(
        2.0 * p1 * w.y + 6.0 * p2 * w.x + prism.x * w.x, 2.0 * p2 * w.y + 2.0 * p1 * w.x + prism.y * w.x,
        2.0 * p1 * w.x + 2.0 * p2 * w.y + prism.x * w.y, 2.0 * p2 * w.x + 6.0 * p1 * w.y + prism.y * w.y);
}

vec2 lens_point(vec2 ray) {
    vec2 a = ray * lens_magnifications(ray).y;
    vec2 b = a * lens_stretch(dot(a, a)).x;
    return b + lens_skew(u_lens_skew_last ? b : a);
}

mat2 lens_jacobian(vec2 ray) {
    vec3 m = lens_magnifications(ray);
    vec2 n = ray / m.x, a = ray * m.y;
    mat2 bend = mat2(m.y) + (m.z - m.y) * outerProduct(n, n);
    vec2 ratio = lens_stretch(dot(a, a));
    mat2 grow = mat2(ratio.x) + 2.0 * ratio.y * outerProduct(a, a);
    if (u_lens_skew_last) return (mat2(1.0) + lens_skew_jacobian(a * ratio.x)) * grow * bend;
    return (grow + lens_skew_jacobian(a)) * bend;
}
