// Blends a tile's splats, each pixel in the order of the depths along its own ray, as far as a buffer of its NEAREST
// splats can sort them: see raster/forward_per_pixel.py. One invocation per pixel; PIXELS work groups per tile.
// Flags: those of batches, with SLOPES, and NEAREST.
#include "tiles/batches.glsl"

layout(local_size_x = WORKGROUP) in;

const float BEFORE_ALL = -1e30;

void main() {
    int me = int(gl_LocalInvocationID.x), index = int(gl_WorkGroupID.z) * WORKGROUP + me;
    ivec2 tile = ivec2(gl_WorkGroupID.xy);
    uvec2 range = range_of(group_number());
    if (range.x == range.y && !u_starts) return;
    ivec2 pixel = tile * TILE + ivec2(index % TILE, index / TILE);
    bool inside = all(lessThan(pixel, imageSize(u_accumulation)));
    vec4 sum = drawn_at(pixel);  // rgb, T
    // The buffer, nearest first; its empty places are before all, with an alpha of 0.
    float depths[NEAREST];
    vec4 held[NEAREST];  // rgb, alpha
    for (int i = 0; i < NEAREST; i++) {
        depths[i] = BEFORE_ALL;
        held[i] = vec4(0.0);
    }
    for (uint first = range.x; first < range.y; first += uint(BATCH)) {
        if (me == 0) open_pixels = 0u;
        memoryBarrierShared(); barrier();
        if (sum.a >= u_early_stop) atomicOr(open_pixels, 1u);
        uint count = fill_batch(first, min(range.y - first, uint(BATCH)), tile);
        memoryBarrierShared(); barrier();
        if (open_pixels == 0u) {
            has_more = false;
            break;
        }
        for (uint k = 0u; k < count; k++) {
            vec4 shape = batch_shapes[k], colour = batch_colours[k], depth = batch_depths[k];
            vec2 d = vec2(pixel) + 0.5 - shape.xy;
            vec2 whitened = vec2(shape.z * d.x + shape.w * d.y, batch_cs[k] * d.y);
            float alpha = colour.a * exp2(-dot(whitened, whitened));
            float cut = max(u_alpha_cut, u_least_share * colour.a);
            if (!(alpha >= cut) || !(u_max_alpha >= cut) || !(sum.a >= u_early_stop)) continue;
            alpha = min(alpha, u_max_alpha);
            // Inserted from behind, after those of equal depth; the splat that drops out in front is blended.
            float z = depth.z + dot(depth.xy, d);
            vec4 carried = vec4(colour.rgb, alpha);
            for (int i = NEAREST - 1; i >= 0; i--) {  // without branches: compilers unroll it into registers
                bool later = z >= depths[i];
                float other_z = depths[i];
                vec4 other = held[i];
                depths[i] = later ? z : other_z;
                held[i] = later ? carried : other;
                z = later ? other_z : z;
                carried = later ? other : carried;
            }
            sum.rgb += sum.a * carried.a * carried.rgb;
            sum.a *= 1.0 - carried.a;
        }
        memoryBarrierShared(); barrier();
    }
    for (int i = 0; i < NEAREST; i++) {
        sum.rgb += sum.a * held[i].a * held[i].rgb;
        sum.a *= 1.0 - held[i].a;
    }
    if (inside) imageStore(u_accumulation, pixel, sum);
    call_next_part();
}
