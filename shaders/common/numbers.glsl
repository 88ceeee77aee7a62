// Finite tests by bit pattern: compilers may fold isnan() and x != x away.

bool is_finite(float v) { return (floatBitsToUint(v) & 0x7F800000u) != 0x7F800000u; }
bool is_finite(vec2 v) { return is_finite(v.x) && is_finite(v.y); }
bool is_finite(vec3 v) { return is_finite(v.xy) && is_finite(v.z); }
bool is_finite(vec4 v) { return is_finite(v.xy) && is_finite(v.zw); }

// a / b. GPUs multiply by the reciprocal of b, which is subnormal from 2^126 on, and counts as 0: an H200 gave 0
// for 1e38 / 1e38. Both are made smaller first, by a power of two, so that no digit changes.
const float GREAT_DIVISOR = 1e19, SHRUNK = 5.421010862427522e-20;  // 2^-64
vec4 quotient(vec4 a, float b) {
    float unit = abs(b) > GREAT_DIVISOR ? SHRUNK : 1.0;
    return (a * unit) / (b * unit);
}
vec3 quotient(vec3 a, float b) { return quotient(vec4(a, 0.0), b).xyz; }
vec2 quotient(vec2 a, float b) { return quotient(vec4(a, 0.0, 0.0), b).xy; }
float quotient(float a, float b) { return quotient(vec4(a), b).x; }

// sqrt(a² + b²), of numbers whose squares may leave float32's range.
vec2 hypotenuse(vec2 a, vec2 b) {
    vec2 unit = max(max(abs(a), abs(b)), 1e-30);
    a = vec2(quotient(a.x, unit.x), quotient(a.y, unit.y));
    b = vec2(quotient(b.x, unit.x), quotient(b.y, unit.y));
    return unit * sqrt(a * a + b * b);
}
