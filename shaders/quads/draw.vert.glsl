// Four vertices per splat, nearest splat first.
// Flags: QUADS_PER_INSTANCE, POINTS, DEPTH (the splat's depth in place of its colour), STOCHASTIC (in any
// order, for a depth test), WEIGHTED (in any order, with a weight by depth), DISCS, TINTS, TEXTURE_WIDTH.
#include "quads/culled.glsl"
#include "common/quad.glsl"
#include "common/tint.glsl"
#include "common/records.glsl"
layout(std430, binding = 0) readonly buffer Order { uint order[]; };
layout(std430, binding = 1) readonly buffer Slabs { uint slab_starts[]; };
RECORDS_READ(2);
layout(std430, binding = 3) readonly buffer DepthKeys { uint depth_keys[]; };
#if HAS_DISCS
ROWS_READ(4, 6, Discs, discs);
#endif

float depth_of(uint splat) { return uintBitsToFloat(depth_keys[splat] & 0x7FFFFFFFu); }  // visible: positive
#if HAS_STOCHASTIC
uniform float u_depth_unit;  // world units; depths about it keep the most digits
flat out uint v_splat;
#endif
#if HAS_WEIGHTED
uniform float u_nearest;      // depth at which weights are 1, world units
uniform float u_weight_fall;  // decrease of the weight's natural logarithm per world unit of depth
flat out float v_weight;
const float LEAST_WEIGHT = 1e-12;  // the farthest splat still has a colour
#endif
uniform uint u_slab;

void main() {
    uint slot = slab_starts[u_slab] + uint(gl_InstanceID) * uint(QUADS_PER_INSTANCE) + uint(gl_VertexID >> 2);
    uint splat = slot < slab_starts[u_slab + 1u] ? order[slot] : CULLED;
    if (splat == CULLED) {
        place_nothing();
#if HAS_STOCHASTIC
        v_splat = CULLED;
#endif
#if HAS_WEIGHTED
        v_weight = 0.0;
#endif
        return;
    }
    vec4 colour = RECORD(colours, splat);
    if (DEPTH) colour.rgb = vec3(depth_of(splat));
    colour.rgb = tinted(splat, colour.rgb);
    place_quad(RECORD(shapes, splat), RECORD(bounds, splat), colour);
#if HAS_DISCS
    if (DISCS) {
        v_rows = ROW(discs, 2u * splat);
        v_plane = ROW(discs, 2u * splat + 1u);
    }
#endif
#if HAS_WEIGHTED
    if (WEIGHTED) v_weight = clamp(exp(-u_weight_fall * (depth_of(splat) - u_nearest)), LEAST_WEIGHT, 1.0);
#endif
#if HAS_STOCHASTIC
    if (STOCHASTIC) {
        float depth = depth_of(splat);
        gl_Position.z = depth / (depth + u_depth_unit) * 2.0 - 1.0;
        v_splat = splat;
    }
#endif
}
