// The colour of a splat's normal, by scene/normals.py: the shortest axis, of discs their plane's, facing the eye.
// Flags: DISCS, ORTHOGRAPHIC. To be included after common/edits.glsl.

vec3 normal_colour(Splat s) {
    float largest = max(max(abs(s.quat.x), abs(s.quat.y)), max(abs(s.quat.z), abs(s.quat.w)));
    mat3 axes = rotation_matrix(s.quat, largest);
    vec3 axis = axes[0];
    float least = s.scale.x;
    if (s.scale.y < least) { axis = axes[1]; least = s.scale.y; }
    if (DISCS || s.scale.z < least) axis = axes[2];
    vec3 normal = u_camera_from_world * axis;
    vec3 ray = ORTHOGRAPHIC ? vec3(0.0, 0.0, 1.0) : u_camera_from_world * s.offset;
    if (dot(normal, ray) > 0.0) normal = -normal;
    return 0.5 + 0.5 * vec3(normal.x, -normal.y, -normal.z);
}
