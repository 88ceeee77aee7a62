// EWA projection of one Gaussian, by the rules of scene/image_model.py (steps 1 to 3) and in the forms of
// scene/projection.py that keep float32 accurate. Flags: ANTIALIASED, LENS, ORTHOGRAPHIC, DISCS (splats are
// surfels: without ANTIALIASED and LENS), SLOPES (depth pixel by pixel, as raster/forward_per_pixel.py has it).
#include "common/lens.glsl"
#include "common/numbers.glsl"

uniform mat3 u_camera_from_world;  // world axes to camera axes
uniform vec3 u_eye_high;           // the eye relative to the scene's centre; high + low carry float64's digits
uniform vec3 u_eye_low;
uniform vec2 u_focal;              // px, or px per world unit where rays are parallel
uniform vec2 u_principal;          // px
uniform vec2 u_size;               // px
uniform vec4 u_ray_limits;         // least and greatest t.xy / t.z that the Jacobian trusts
uniform float u_near;
uniform float u_blur;              // px²
uniform float u_alpha_cut;
uniform float u_least_share;       // share of its opacity below which a splat's alpha is 0, too

#if HAS_DISCS
#include "common/surfel_projection.glsl"
#endif

const float MIN_QUAT_COMPONENT = 1e-30;
const float WHOLE_IMAGE = 1e38;    // px; half an axis where no alpha cut bounds the footprint

struct Footprint {
    vec2 mean;       // px
    vec3 conic;      // a, b, c in 1/px: q = (a dx + b dy)² + (c dy)²
    vec2 major_axis; // px, to where alpha falls below the cut
    float minor_axis;
    float opacity;
    float depth;     // t.z
    vec3 direction;  // unit, world axes, from the eye
#if HAS_SLOPES
    vec2 depth_slope; // world units per px: depth of the densest point on a pixel's ray, less `depth`
#endif
#if HAS_DISCS
    Surfel surfel;       // decides alpha: the conic and its axes are those of an ellipse around it
#endif
};

mat3 rotation_matrix(vec4 quat, float largest) {
    // By the largest component first: the squares of 1e-25 or 1e25 leave float32's range.
    vec4 q = normalize(quotient(quat, largest));  // guard: largest component first := vec4 q = normalize(quat);
    float w = q.x, x = q.y, y = q.z, z = q.w;
    return mat3(
        1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y),
        2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x),
        2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y));
}

// From the eye to `position`, which is relative to the scene's centre.
vec3 from_eye(vec3 position) { return (position - u_eye_high) - u_eye_low; }

// False where the splat is culled. `offset` is from the eye, `scale` and `opacity` are activated, `quat` is
// wxyz of any length. Every guard is phrased so that NaN fails it.
bool project(vec3 offset, vec4 quat, vec3 scale, float opacity, out Footprint f) {
    vec3 t = u_camera_from_world * offset;
    float largest = max(max(abs(quat.x), abs(quat.y)), max(abs(quat.z), abs(quat.w)));
    if (!(t.z >= u_near)) return false;  // guard: near plane
    if (!(largest >= MIN_QUAT_COMPONENT)) return false;  // guard: zero quaternions
    // By bits too: compilers with fast maths may turn !(x >= a) into x < a, which NaN passes.
    if (!is_finite(opacity) || !(opacity >= u_alpha_cut) || !(opacity > 0.0)) return false;  // guard: opacity
    // guard: finite footprints
    if (!is_finite(offset) || !is_finite(t) || !is_finite(quat) || !is_finite(scale)) return false;

    vec2 ray = ORTHOGRAPHIC ? t.xy : quotient(t.xy, t.z);
    f.mean = ray * u_focal + u_principal;
    if (LENS) {
        if (!(dot(ray, ray) < u_lens_reach)) return false;  // guard: fold of the lens
        f.mean = lens_point(ray) * u_focal + u_principal;
    }
    f.depth = t.z;
    // guard: largest offset first := f.direction = normalize(offset);
    f.direction = normalize(quotient(offset, max(max(abs(offset.x), abs(offset.y)), abs(offset.z))));
    if (ORTHOGRAPHIC) f.direction = vec3(u_camera_from_world[0].z, u_camera_from_world[1].z, u_camera_from_world[2].z);

    // Rows of M = J·W·R·diag(s), divided by their largest entry so that a huge splat does not overflow.
    mat3 axes = u_camera_from_world * rotation_matrix(quat, largest);
    mat3 unit_axes = axes;
    axes = mat3(axes[0] * scale.x, axes[1] * scale.y, axes[2] * scale.z);
    vec3 m0 = vec3(axes[0].x, axes[1].x, axes[2].x), m1 = vec3(axes[0].y, axes[1].y, axes[2].y);
    vec2 scaled = u_focal;
    if (!ORTHOGRAPHIC) {
        vec2 slope = clamp(ray, u_ray_limits.xy, u_ray_limits.zw);  // guard: slope clamp := vec2 slope = ray;
        vec3 row_z = vec3(axes[0].z, axes[1].z, axes[2].z);
        m0 -= slope.x * row_z;
        m1 -= slope.y * row_z;
        scaled = quotient(u_focal, t.z);
        if (LENS) {
            mat2 bent = lens_jacobian(slope);
            vec3 straight = m0;
            m0 = bent[0].x * straight + bent[1].x * m1;
            m1 = bent[0].y * straight + bent[1].y * m1;
        }
    }
    m0 *= scaled.x;
    m1 *= scaled.y;
#if HAS_DISCS
    if (DISCS) {
        float least = max(u_alpha_cut, u_least_share * opacity);
        float surfel_radius_squared = least > 0.0 ? max(2.0 * log(opacity / least), 0.0) + 1e-3 : UNBOUNDED_RADIUS_SQUARED;
        if (!surfel_of(t, unit_axes, scale, surfel_radius_squared, f.surfel, m0, m1)) return false;
    }
#endif
    if (!is_finite(m0) || !is_finite(m1)) return false;  // guard: finite footprints
    vec3 entries = max(abs(m0), abs(m1));
    float spread = max(max(max(entries.x, entries.y), entries.z), 1.0);  // guard: spread := float spread = 1.0;
    m0 = quotient(m0, spread);
    m1 = quotient(m1, spread);
    float blur = u_blur / spread / spread;
    float m00 = dot(m0, m0), m11 = dot(m1, m1), xy = dot(m0, m1);
    vec3 area = cross(m0, m1);
    // guard: determinant as a sum := float det_unblurred = m00 * m11 - xy * xy;
    float det_unblurred = dot(area, area);
    float det = det_unblurred + blur * (m00 + m11) + blur * blur;
    float xx = m00 + blur, yy = m11 + blur;
    if (!(det > 0.0)) return false;

    f.opacity = opacity;
    if (ANTIALIASED) {
        f.opacity *= sqrt(det_unblurred / det);
        if (!(f.opacity >= u_alpha_cut) || !(f.opacity > 0.0)) return false;
    }
    float a = sqrt(yy / det) / spread;
    f.conic = vec3(a, -xy / yy * a, 1.0 / (sqrt(yy) * spread));
#if HAS_SLOPES
    vec3 along_z = vec3(axes[0].z, axes[1].z, axes[2].z);
    vec2 covariance = spread * vec2(dot(m0, along_z), dot(m1, along_z));
    float whitened = f.conic.x * covariance.x + f.conic.y * covariance.y;
    f.depth_slope = vec2(f.conic.x * whitened, f.conic.y * whitened + f.conic.z * f.conic.z * covariance.y);
    // A determinant that has lost its digits is not used.
    if (!(det > 1e-9 * xx * yy) || !is_finite(f.depth_slope)) f.depth_slope = vec2(0.0);
#endif
    // guard: finite footprints
    if (!is_finite(f.conic) || !is_finite(f.mean) || !is_finite(vec2(xx, yy) * spread * spread)) return false;

    // The ellipse alpha = cut: along the eigenvectors, 1-sigma lengths sqrt(eigenvalue).
    float cut = max(u_alpha_cut, u_least_share * f.opacity);
    if (cut > 0.0) {
        float half_difference = 0.5 * (xx - yy);
        float root = sqrt(half_difference * half_difference + xy * xy);
        float major = 0.5 * (xx + yy) + root;
        vec2 along = half_difference >= 0.0 ? vec2(half_difference + root, xy) : vec2(xy, root - half_difference);
        float stretch = max(abs(along.x), abs(along.y));
        along = stretch > 0.0 ? normalize(along / stretch) : vec2(1.0, 0.0);
        // A little wide, because log() is only good to 1e-4 or so on some drivers.
        float radius = sqrt(max(2.0 * log(f.opacity / cut), 0.0) + 1e-3) * spread;
        f.major_axis = along * (radius * sqrt(major));
        f.minor_axis = radius * sqrt(det / major);
        vec2 extent = radius * sqrt(vec2(xx, yy)) + 0.02;  // guard: huge extents := vec2 extent = min(radius * sqrt(vec2(xx, yy)), 1e18) + 0.02;
        // Off screen: no pixel centre within the box.
        if (any(lessThan(f.mean + extent, vec2(0.5))) || any(greaterThan(f.mean - extent, u_size - 0.5))) return false;
    } else {
        f.major_axis = vec2(WHOLE_IMAGE, 0.0);
        f.minor_axis = WHOLE_IMAGE;
    }
    return true;
}
