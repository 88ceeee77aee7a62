// A page's attributes as they are stored, by scene/attribute_formats.py. Flags: ATTRIBUTES (0 float32, 1 float16, 2 the
// same with 8-bit harmonics); for programs that use rests, WIDE (positions have them).

layout(std430, binding = 0) readonly buffer Positions { float positions[]; };
#if ATTRIBUTES == 0
layout(std430, binding = 1) readonly buffer Quats { vec4 quats[]; };
layout(std430, binding = 2) readonly buffer Scales { vec4 scales_opacity[]; };

vec4 quat_of(uint local) { return quats[local]; }
vec4 scale_opacity_of(uint local) { return scales_opacity[local]; }
#else
layout(std430, binding = 1) readonly buffer Quats { uvec2 quats[]; };
layout(std430, binding = 2) readonly buffer Scales { uvec2 scales_opacity[]; };  // log-scales here

vec4 halves(uvec2 packed_halves) { return vec4(unpackHalf2x16(packed_halves.x), unpackHalf2x16(packed_halves.y)); }
vec4 quat_of(uint local) { return halves(quats[local]); }
vec4 scale_opacity_of(uint local) {
    vec4 stored = halves(scales_opacity[local]);
    return vec4(exp(stored.xyz), stored.w);
}
#endif

vec3 position_of(uint local) {
    return vec3(positions[3u * local], positions[3u * local + 1u], positions[3u * local + 2u]);
}

// The position less its float32 rounding, in a page of `count` splats of a wide scene.
vec3 position_rest_of(uint local, uint count) { return position_of(count + local); }
