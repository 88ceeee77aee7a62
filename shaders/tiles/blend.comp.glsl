// Blends a tile's splats into the picture, front to back, a batch at a time; one work group per tile. All but
// the first start from the target's content, so one picture may take several of these, nearer splats first.
// Flags: those of batches.
#include "tiles/batches.glsl"
#define PIXELS (TILE * TILE / WORKGROUP)

layout(local_size_x = WORKGROUP) in;

// From an invocation's first pixel to its others: whole rows, or parts of one, as WORKGROUP and TILE are
// multiples of each other.
ivec2 step_to(int index) { return ivec2(index * WORKGROUP % TILE, index * WORKGROUP / TILE); }

void main() {
    uint me = gl_LocalInvocationID.x;
    ivec2 tile = ivec2(gl_WorkGroupID.xy);
    uvec2 range = range_of(group_number());
    if (range.x == range.y && !u_starts) return;
    ivec2 size = imageSize(u_accumulation), own = tile * TILE + ivec2(int(me) % TILE, int(me) / TILE);
    vec4 sums[PIXELS];  // rgb, T
    for (int i = 0; i < PIXELS; i++) sums[i] = drawn_at(own + step_to(i));
    for (uint first = range.x; first < range.y; first += uint(BATCH)) {
        if (me == 0u) open_pixels = 0u;
        memoryBarrierShared(); barrier();
        bool open = false;
        for (int i = 0; i < PIXELS; i++) open = open || sums[i].a >= u_early_stop;
        if (open) atomicOr(open_pixels, 1u);
        uint count = fill_batch(first, min(range.y - first, uint(BATCH)), tile);
        memoryBarrierShared(); barrier();
        if (open_pixels == 0u) {
            has_more = false;
            break;
        }
        for (uint k = 0u; k < count; k++) {
            // Whole warps of a GPU are through then; where an invocation has many pixels, few are at once.
            if (PIXELS == 1 && !(sums[0].a >= u_early_stop)) break;
            vec4 shape = batch_shapes[k], colour = batch_colours[k];
            vec2 offset = vec2(own) + 0.5 - shape.xy;
            float c = batch_cs[k], cut = max(u_alpha_cut, u_least_share * colour.a);
#if HAS_DISCS
            vec4 rows = batch_rows[k], plane = batch_planes[k];
#endif
            for (int i = 0; i < PIXELS; i++) {
                vec2 d = offset + vec2(step_to(i));
                vec2 whitened = vec2(shape.z * d.x + shape.w * d.y, c * d.y);
                float power = dot(whitened, whitened);
#if HAS_DISCS
                if (DISCS) power = surfel_power(rows, plane, d);
#endif
                float alpha = colour.a * exp2(-power);
                // The cut before min, which drivers may let turn NaN into its other argument.
                alpha = alpha >= cut && u_max_alpha >= cut ? min(alpha, u_max_alpha) : 0.0;
                sums[i].rgb += sums[i].a * alpha * colour.rgb;
                sums[i].a *= 1.0 - alpha;
            }
        }
        memoryBarrierShared(); barrier();
    }
    for (int i = 0; i < PIXELS; i++) {
        ivec2 pixel = own + step_to(i);
        if (all(lessThan(pixel, size))) imageStore(u_accumulation, pixel, sums[i]);
    }
    call_next_part();
}
