// A tile's splats, in batches in local memory: the part that all ways of blending share.
// Flags: REST (tries all splats that found no room among the pairs), WORKGROUP, BATCH, ROUNDS, TINTS, DISCS
// (splats are surfels), SLOPES (depth pixel by pixel), and those of outline.
#include "tiles/outline.glsl"
#include "tiles/plan.glsl"
#include "common/groups.glsl"
#include "common/falloff.glsl"
#include "common/tint.glsl"
#if HAS_DISCS
#include "common/surfel.glsl"
#endif

layout(std430, binding = 0) readonly buffer PairTiles { uint pair_tiles[]; };  // ascending
layout(std430, binding = 1) readonly buffer Splats { uint splats[]; };         // of pairs; with REST of slots
#if HAS_DISCS
ROWS_READ(5, 6, Discs, discs);                                                  // two per splat: rows, plane
#endif
layout(rgba32f, binding = 0) uniform image2D u_accumulation;                       // rgb, T
layout(std430, binding = 4) writeonly buffer NextParts { uint next_parts[]; };  // three a part: an indirect dispatch
uniform uint u_round;
uniform uint u_first;  // range of the tile's splats: the first, and the greatest count
uniform uint u_most;
uniform bool u_starts;  // nothing is drawn yet, whatever the target holds
uniform float u_max_alpha;
uniform float u_early_stop;

// One batch, with a, b and c in the unit that makes the exponent one of 2.
shared vec4 batch_shapes[BATCH];
shared float batch_cs[BATCH];
shared vec4 batch_colours[BATCH];
#if HAS_SLOPES
ROWS_READ(6, 7, Slopes, slopes);
shared vec4 batch_depths[BATCH];  // slopes and depth of the mean
#endif
#if HAS_DISCS
shared vec4 batch_rows[BATCH];
shared vec4 batch_planes[BATCH];
#endif
bool has_more;  // the tile has splats beyond this part
shared uint borders[2];
shared uint open_pixels;
#if HAS_REST
const uint WORDS = uint(BATCH) / 32u;
shared uint hits[WORDS];
#endif

// rgb and T of a pixel so far; outside the picture it is opaque.
vec4 drawn_at(ivec2 pixel) {
    if (!all(lessThan(pixel, imageSize(u_accumulation)))) return vec4(0.0);
    // No branch: zink on a CPU compiles uniforms that decide one into the shader, and keeps old ones.
    return mix(imageLoad(u_accumulation, pixel), vec4(0.0, 0.0, 0.0, 1.0), bvec4(u_starts));
}

// The first pair of `tile` or a later one.
uint first_pair(uint tile) {
    uint low = 0u, high = plan.round_pairs[u_round];
    while (low < high) {
        uint middle = (low + high) / 2u;
        if (pair_tiles[middle] < tile) low = middle + 1u;
        else high = middle;
    }
    return low;
}

void put(uint place, uint splat) {
    vec4 shape = RECORD(shapes, splat), colour = RECORD(colours, splat);
    batch_shapes[place] = vec4(shape.xy, shape.zw * ROOT_HALF_LOG2_E);
    batch_cs[place] = RECORD(bounds, splat).x * ROOT_HALF_LOG2_E;
    batch_colours[place] = vec4(tinted(splat, colour.rgb), colour.a);
#if HAS_SLOPES
    batch_depths[place] = ROW(slopes, splat);
#endif
#if HAS_DISCS
    if (DISCS) {
        batch_rows[place] = ROW(discs, 2u * splat);
        batch_planes[place] = ROW(discs, 2u * splat + 1u);
    }
#endif
}

#if HAS_REST
bool touches(uint splat, ivec2 tile) {
    Outline o = outline_of(splat);
    ivec2 rows = rows_of(o);
    if (tile.y < rows.x || tile.y > rows.y) return false;
    ivec2 columns = columns_of(o, tile.y);
    return tile.x >= columns.x && tile.x <= columns.y;
}

// Keeps the splats that touch the tile, in order.
uint fill_batch(uint first, uint count, ivec2 tile) {
    uint me = gl_LocalInvocationID.x;
    for (uint word = me; word < WORDS; word += uint(WORKGROUP)) hits[word] = 0u;
    memoryBarrierShared(); barrier();
    for (uint i = me; i < count; i += uint(WORKGROUP))
        if (touches(splats[first + i], tile)) atomicOr(hits[i / 32u], 1u << (i % 32u));
    memoryBarrierShared(); barrier();
    for (uint i = me; i < count; i += uint(WORKGROUP)) {
        uint word = i / 32u, bit = 1u << (i % 32u);
        if ((hits[word] & bit) == 0u) continue;
        uint place = uint(bitCount(hits[word] & (bit - 1u)));
        for (uint below = 0u; below < word; below++) place += uint(bitCount(hits[below]));
        put(place, splats[first + i]);
    }
    uint kept = 0u;
    for (uint word = 0u; word < WORDS; word++) kept += uint(bitCount(hits[word]));
    return kept;
}
#else
uint fill_batch(uint first, uint count, ivec2 tile) {
    for (uint i = gl_LocalInvocationID.x; i < count; i += uint(WORKGROUP)) put(i, splats[first + i]);
    return count;
}
#endif

// Has the next part drawn, over all tiles, where this one is not through with its own.
void call_next_part() {
    if (!has_more || gl_LocalInvocationID.x != 0u) return;
    uint part = u_first / u_most;
    for (int i = 0; i < 3; i++) next_parts[3u * part + uint(i)] = gl_NumWorkGroups[i];
}

// First and end of the tile's splats in this dispatch; to be called by all of a work group.
uvec2 range_of(uint number) {
#if HAS_REST
    uvec2 range = uvec2(plan.rest_first, plan.rest_end);
#else
    for (uint i = gl_LocalInvocationID.x; i < 2u; i += uint(WORKGROUP)) borders[i] = first_pair(number + i);
    memoryBarrierShared(); barrier();
    uvec2 range = uvec2(borders[0], borders[1]);
#endif
    has_more = range.y - range.x > u_first + u_most;
    if (range.y - range.x <= u_first) return uvec2(0u);
    range.x += u_first;
    return uvec2(range.x, range.x + min(range.y - range.x, u_most));
}
