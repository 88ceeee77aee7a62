// Depth key and index of every splat of a page, visible or not. Flags: GROUP_SIZE, ANTIALIASED, and those
// of attributes and edits.
#include "common/edits.glsl"
#include "common/groups.glsl"
layout(local_size_x = GROUP_SIZE) in;

#include "quads/attributes.glsl"
layout(std430, binding = 4) writeonly buffer Keys { uint keys[]; };
layout(std430, binding = 5) writeonly buffer Order { uint order[]; };
uniform uint u_page_first;
uniform uint u_page_count;
uniform uint u_key_base;
uniform uint u_key_shift;
uniform uint u_key_most;

void main() {
    uint local = group_number() * uint(GROUP_SIZE) + gl_LocalInvocationID.x;
    if (local >= u_page_count) return;
    uint splat = u_page_first + local;
    Splat s = unedited(position_of(local), vec4(1.0, 0.0, 0.0, 0.0), vec3(1.0), 1.0);
    edit(splat, s);
    float depth = (u_camera_from_world * s.offset).z;
    // A splat before the near plane, or of no depth, is never drawn.
    uint key = depth >= u_near ? floatBitsToUint(depth) | 0x80000000u : 0u;
    keys[splat] = min((max(key, u_key_base) - u_key_base) >> u_key_shift, u_key_most);
    order[splat] = splat;
}
