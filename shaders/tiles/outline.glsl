// The ellipse within which one splat's alpha reaches the cut, and the tiles that have a pixel centre in it.
// Everything is a little wide, never narrow: alpha alone decides what a pixel shows.
// Flag: TILE (pixels that a tile is wide and high), and those of records.
#include "common/records.glsl"

RECORDS_READ(2);
uniform ivec2 u_tiles;  // columns, rows
uniform float u_alpha_cut;
uniform float u_least_share;  // share of its opacity below which a splat's alpha is 0, too

struct Outline {
    vec2 mean;      // px
    vec3 conic;     // a, b, c in 1/px: q = (a dx + b dy)² + (c dy)², see common/projection.glsl
    float radius;    // the ellipse is q = radius²
    float height;   // px, half of the ellipse's height
    float shear;  // place of the rightmost point: this share of `height` above the mean
};

const float EVERYWHERE = 1e18;    // radius without an alpha cut
const float LEAST_CONIC = 1e-20;  // 1/px; projection culls what is flatter
const float LEAST_PAD = 0.02;     // px
const float ROUNDING = 2e-6;      // of the numbers that make up an edge

Outline outline_of(uint splat) {
    Outline o;
    vec4 shape = RECORD(shapes, splat);
    o.mean = shape.xy;
    o.conic = vec3(shape.zw, RECORD(bounds, splat).x);
    o.radius = EVERYWHERE;
    // 1e-3 because log() is only good to 1e-4 or so on some drivers.
    float opacity = RECORD(colours, splat).a, cut = max(u_alpha_cut, u_least_share * opacity);
    if (cut > 0.0) o.radius = sqrt(max(2.0 * log(opacity / cut), 0.0) + 1e-3);
    o.height = o.radius / max(o.conic.z, LEAST_CONIC);
    float column_length = length(o.conic.yz);
    o.shear = column_length > 0.0 ? o.conic.y / column_length : 0.0;
    return o;
}

// The first of `count` tiles with a pixel centre at or after `low`. NaN takes all in.
int first_tile(float low, int count) {
    float tile = ceil((low + 0.5) / float(TILE)) - 1.0;
    return tile > 0.0 ? int(min(tile, float(count))) : 0;
}

// The last of `count` tiles with a pixel centre at or before `high`, -1 for none. NaN takes all in.
int last_tile(float high, int count) {
    float tile = floor((high - 0.5) / float(TILE));
    return tile < float(count - 1) ? int(max(tile, -1.0)) : count - 1;
}

// First and last row of tiles.
ivec2 rows_of(Outline o) {
    float far = o.height + LEAST_PAD + ROUNDING * abs(o.mean.y);
    return ivec2(first_tile(o.mean.y - far, u_tiles.y), last_tile(o.mean.y + far, u_tiles.y));
}

// First and last column of tiles in a row that is one of `rows_of`; empty where first > last.
ivec2 columns_of(Outline o, int row) {
    float pad = LEAST_PAD + ROUNDING * abs(o.mean.y);
    float top = float(row * TILE) + 0.5 - o.mean.y;
    vec2 strip = clamp(vec2(top - pad, top + float(TILE - 1) + pad), vec2(-o.height), vec2(o.height));
    // The right edge a dx = -b dy + sqrt(radius² - (c dy)²) is concave: farthest out where its slope is 0 or,
    // where that is beside the strip, at the strip's nearer border. The left edge is its mirror image.
    vec2 widest = clamp(vec2(o.shear, -o.shear) * o.height, strip.xx, strip.yy);
    vec2 down = o.conic.z * widest;
    vec2 half_width = sqrt(max(vec2(o.radius * o.radius) - down * down, vec2(0.0)));
    float a = max(o.conic.x, LEAST_CONIC);
    vec2 middle = -o.conic.y * widest / a;
    vec2 edges = o.mean.x + middle + vec2(-1.0, 1.0) * half_width / a;
    vec2 pads = vec2(LEAST_PAD) + ROUNDING * (abs(o.mean.x) + abs(middle));
    return ivec2(first_tile(edges.x - pads.x, u_tiles.x), last_tile(edges.y + pads.y, u_tiles.x));
}
