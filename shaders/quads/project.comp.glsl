// One invocation per splat: footprint, colour and depth key. A culled splat gets the key CULLED and no record.
// Flags: GROUP_SIZE, WIDE, SH_DEGREE, ANTIALIASED, and those of attributes, harmonics and edits.
#include "quads/culled.glsl"
#include "common/edits.glsl"
#include "common/groups.glsl"
#include "common/sh.glsl"
layout(local_size_x = GROUP_SIZE) in;

// One page of the scene: as many splats as fit into one storage buffer of the driver.
#include "quads/attributes.glsl"
#include "quads/harmonics.glsl"
uniform uint u_page_first;
uniform uint u_page_count;

// Of all pages, indexed by splat.
layout(std430, binding = 4) writeonly buffer Shapes { vec4 shapes[]; };     // mean.xy, a, b
layout(std430, binding = 5) writeonly buffer Bounds { vec4 bounds[]; };     // c, minor axis, major axis.xy
layout(std430, binding = 6) writeonly buffer Colours { vec4 colours[]; };   // rgb, opacity
layout(std430, binding = 7) writeonly buffer DepthKeys { uint depth_keys[]; };
layout(std430, binding = 8) buffer GroupCounts { uint group_counts[]; };
#if HAS_DISCS
layout(std430, binding = 9) writeonly buffer Discs { vec4 discs[]; };       // two per splat: rows, plane
#endif
#if HAS_SLOPES
layout(std430, binding = 10) writeonly buffer Slopes { vec4 slopes[]; };    // of depth, then depth
#endif

uint depth_key(float depth) {
    // Orders as the float does, negative depths included.
    uint bits = floatBitsToUint(depth);
    return (bits & 0x80000000u) != 0u ? ~bits : bits | 0x80000000u;
}

void main() {
    uint local = group_number() * uint(GROUP_SIZE) + gl_LocalInvocationID.x;
    if (local >= u_page_count) return;
    uint splat = u_page_first + local;
    depth_keys[splat] = CULLED;
    vec4 scale_opacity = scale_opacity_of(local);
    Splat s = unedited(position_of(local), quat_of(local), scale_opacity.xyz, scale_opacity.w);
    if (WIDE) s.offset += position_rest_of(local, u_page_count);
    Footprint f;
    if (!edit(splat, s) || !project(s.offset, s.quat, s.scale, s.opacity, f)) return;
    vec3 colour = graded(splat, sh_colour(local, harmonics_direction(splat, f.direction)));
    if (!is_finite(colour)) return;  // guard: finite colours
    shapes[splat] = vec4(f.mean, f.conic.xy);
    bounds[splat] = vec4(f.conic.z, f.minor_axis, f.major_axis);
    // guard: colours at least 0 := colours[splat] = vec4(colour, f.opacity);
    colours[splat] = vec4(max(colour, vec3(0.0)), f.opacity);
#if HAS_DISCS
    if (DISCS) {
        discs[2u * splat] = f.surfel.rows;
        discs[2u * splat + 1u] = f.surfel.plane;
    }
#endif
#if HAS_SLOPES
    slopes[splat] = vec4(f.depth_slope, f.depth, 0.0);
#endif
    depth_keys[splat] = depth_key(f.depth);
    atomicAdd(group_counts[splat / uint(GROUP_SIZE)], 1u);
}
