// Four vertices a splat, nearest splat first. Row 0 of the target is the picture's top row.
// Flags: QUADS_PER_INSTANCE, POINTS (discs of one size), DEPTH (the splat's depth in place of its colour).
#include "quads/culled.glsl"
layout(std430, binding = 0) readonly buffer Order { uint order[]; };
layout(std430, binding = 1) readonly buffer Slabs { uint slab_starts[]; };
layout(std430, binding = 2) readonly buffer Shapes { vec4 shapes[]; };
layout(std430, binding = 3) readonly buffer Bounds { vec4 bounds[]; };
layout(std430, binding = 4) readonly buffer Colours { vec4 colours[]; };
#if DEPTH
layout(std430, binding = 5) readonly buffer Keys { uint keys[]; };
#endif
uniform vec2 u_size;
uniform uint u_slab;

flat out vec4 v_shape;    // mean.xy px, then a, b in the unit that makes the exponent one of 2
flat out float v_c;
flat out vec4 v_colour;   // rgb, opacity

const float ROOT_HALF_LOG2_E = 0.84932180028801904;  // exp(-q/2) = exp2(-(0.849 sqrt q)²)
const float POINT_RADIUS = 1.6;                      // px
const float LARGE = 2048.0;                           // px; beyond it the rasteriser's fixed point suffers

void main() {
    uint slot = slab_starts[u_slab] + uint(gl_InstanceID) * uint(QUADS_PER_INSTANCE) + uint(gl_VertexID >> 2);
    uint splat = slot < slab_starts[u_slab + 1u] ? order[slot] : CULLED;
    if (splat == CULLED) {
        gl_Position = vec4(0.0, 0.0, 0.0, 1.0);  // all four: no area
        return;
    }
    vec4 shape = shapes[splat], bound = bounds[splat];
    v_shape = vec4(shape.xy, shape.zw * ROOT_HALF_LOG2_E);
    v_c = bound.x * ROOT_HALF_LOG2_E;
    v_colour = colours[splat];
#if DEPTH
    v_colour.rgb = vec3(uintBitsToFloat(keys[slot] & 0x7FFFFFFFu));  // visible depths are positive
#endif

    vec2 corner = vec2(gl_VertexID & 1, (gl_VertexID >> 1) & 1) * 2.0 - 1.0;
    vec2 major = bound.zw;
    float major_length = length(major);
    vec2 along = major / major_length;
    vec2 minor = bound.y * vec2(-along.y, along.x);
    vec2 position;
#if POINTS
    v_shape.zw = vec2(POINT_RADIUS);
    position = shape.xy + corner * (POINT_RADIUS + 1.0);
#else
    if (major_length <= LARGE) {
        // 1/64 px wider: vertices snap to 1/256 px and must not lose a pixel on the edge.
        position = shape.xy + corner.x * (major + along / 64.0) + corner.y * (minor + vec2(-along.y, along.x) / 64.0);
    } else {
        vec2 extent = sqrt(min(major * major + minor * minor, vec2(1e36))) + 0.02;
        position = clamp(shape.xy + corner * extent, vec2(-1.0), u_size + 1.0);
    }
#endif
    gl_Position = vec4(position / u_size * 2.0 - 1.0, 0.0, 1.0);
}
