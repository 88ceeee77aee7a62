// Finite tests by bit pattern: compilers may fold isnan() and x != x away.

bool is_finite(float v) { return (floatBitsToUint(v) & 0x7F800000u) != 0x7F800000u; }
bool is_finite(vec2 v) { return is_finite(v.x) && is_finite(v.y); }
bool is_finite(vec3 v) { return is_finite(v.xy) && is_finite(v.z); }
bool is_finite(vec4 v) { return is_finite(v.xy) && is_finite(v.zw); }

// sqrt(a² + b²), of numbers whose squares may leave float32's range.
vec2 hypotenuse(vec2 a, vec2 b) {
    vec2 unit = max(max(abs(a), abs(b)), 1e-30);
    a /= unit;
    b /= unit;
    return unit * sqrt(a * a + b * b);
}
