// One invocation a splat: footprint, colour and depth key. A culled splat gets the key CULLED and no record.
// Flags: GROUP_SIZE, SH_DEGREE, SH_STORED (coefficients a splat has in its buffer), ANTIALIASED, and those of
// edits.
#include "quads/culled.glsl"
#include "common/edits.glsl"
#include "common/sh.glsl"
layout(local_size_x = GROUP_SIZE) in;

// One page of the scene: as many splats as fit into one storage buffer of the driver.
layout(std430, binding = 0) readonly buffer Positions { float positions[]; };
layout(std430, binding = 1) readonly buffer Quats { vec4 quats[]; };
layout(std430, binding = 2) readonly buffer Scales { vec4 scales_opacity[]; };
layout(std430, binding = 3) readonly buffer Harmonics { float sh[]; };
uniform uint u_page_first;
uniform uint u_page_count;

// Of all pages, indexed by splat.
layout(std430, binding = 4) writeonly buffer Shapes { vec4 shapes[]; };     // mean.xy, a, b
layout(std430, binding = 5) writeonly buffer Bounds { vec4 bounds[]; };     // c, minor axis, major axis.xy
layout(std430, binding = 6) writeonly buffer Colours { vec4 colours[]; };   // rgb, opacity
layout(std430, binding = 7) writeonly buffer DepthKeys { uint depth_keys[]; };
layout(std430, binding = 8) buffer GroupCounts { uint group_counts[]; };

vec3 sh_coefficient(uint splat, int index) {
    uint at = (splat * uint(SH_STORED) + uint(index)) * 3u;
    return vec3(sh[at], sh[at + 1u], sh[at + 2u]);
}

uint depth_key(float depth) {
    // Orders as the float does, negative depths included.
    uint bits = floatBitsToUint(depth);
    return (bits & 0x80000000u) != 0u ? ~bits : bits | 0x80000000u;
}

void main() {
    uint local = gl_GlobalInvocationID.x;
    if (local >= u_page_count) return;
    uint splat = u_page_first + local;
    depth_keys[splat] = CULLED;
    vec3 position = vec3(positions[3u * local], positions[3u * local + 1u], positions[3u * local + 2u]);
    vec4 scale_opacity = scales_opacity[local];
    Splat s = unedited(position, quats[local], scale_opacity.xyz, scale_opacity.w);
    Footprint f;
    if (!edit(splat, s) || !project(s.offset, s.quat, s.scale, s.opacity, f)) return;
    vec3 colour = graded(splat, sh_colour(local, harmonics_direction(splat, f.direction)));
    if (!is_finite(colour)) return;
    shapes[splat] = vec4(f.mean, f.conic.xy);
    bounds[splat] = vec4(f.conic.z, f.minor_axis, f.major_axis);
    colours[splat] = vec4(max(colour, vec3(0.0)), f.opacity);
    depth_keys[splat] = depth_key(f.depth);
    atomicAdd(group_counts[splat / uint(GROUP_SIZE)], 1u);
}
