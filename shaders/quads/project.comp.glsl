// One invocation per splat: footprint, colour and depth key. A culled splat gets the key CULLED and no record.
// Flags: GROUP_SIZE, WIDE, SH_DEGREE, ANTIALIASED, NORMALS (in place of colours), and those of attributes, harmonics and edits.
#include "quads/culled.glsl"
#include "common/edits.glsl"
#include "common/normal.glsl"
#include "common/groups.glsl"
#include "common/sh.glsl"
#include "common/records.glsl"
layout(local_size_x = GROUP_SIZE) in;

// One page of the scene: as many splats as fit into one storage buffer of the driver.
#include "quads/attributes.glsl"
#include "quads/harmonics.glsl"
uniform uint u_page_first;
uniform uint u_page_count;

// Of all pages, indexed by splat.
RECORDS_WRITTEN(4);
layout(std430, binding = 5) writeonly buffer DepthKeys { uint depth_keys[]; };
layout(std430, binding = 6) buffer GroupCounts { uint group_counts[]; };
#if HAS_DISCS
ROWS_WRITTEN(7, 6, Discs, discs);    // two per splat: rows, plane
#endif
#if HAS_SLOPES
ROWS_WRITTEN(8, 7, Slopes, slopes);  // of depth, then depth
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
    if (NORMALS) colour = normal_colour(s);
    WRITE_RECORD(shapes, splat, vec4(f.mean, f.conic.xy));
    WRITE_RECORD(bounds, splat, vec4(f.conic.z, f.minor_axis, f.major_axis));
    // guard: colours at least 0 := WRITE_RECORD(colours, splat, vec4(colour, f.opacity));
    WRITE_RECORD(colours, splat, vec4(max(colour, vec3(0.0)), f.opacity));
#if HAS_DISCS
    if (DISCS) {
        WRITE_ROW(discs, 2u * splat, f.surfel.rows);
        WRITE_ROW(discs, 2u * splat + 1u, f.surfel.plane);
    }
#endif
#if HAS_SLOPES
    WRITE_ROW(slopes, splat, vec4(f.depth_slope, f.depth, 0.0));
#endif
    depth_keys[splat] = depth_key(f.depth);
    atomicAdd(group_counts[splat / uint(GROUP_SIZE)], 1u);
}
