// Finite tests by bit pattern: compilers may fold isnan() and x != x away.

bool is_finite(float v) { return (floatBitsToUint(v) & 0x7F800000u) != 0x7F800000u; }
bool is_finite(vec2 v) { return is_finite(v.x) && is_finite(v.y); }
bool is_finite(vec3 v) { return is_finite(v.xy) && is_finite(v.z); }
bool is_finite(vec4 v) { return is_finite(v.xy) && is_finite(v.zw); }
