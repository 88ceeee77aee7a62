// A heat ramp whose lightness rises evenly: 0 dark blue, 1 pale yellow.

vec3 ramp(float share) {
    const vec3 STOPS[5] = vec3[](
        vec3(0.02, 0.02, 0.12), vec3(0.32, 0.07, 0.43), vec3(0.73, 0.21, 0.33), vec3(0.97, 0.55, 0.04),
        vec3(0.99, 1.00, 0.64));
    float place = clamp(share, 0.0, 1.0) * 4.0;
    int below = min(int(place), 3);
    return mix(STOPS[below], STOPS[below + 1], place - float(below));
}
