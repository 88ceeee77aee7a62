// The background, as scene/background.py defines it. Flags: GRADIENT, PANORAMA, BEHIND (a picture
// of what this view shows, for cameras whose rays no matrix gives); none: one colour.
uniform vec3 u_background;          // the colour; with GRADIENT that of straight down
uniform vec3 u_top;                 // that of straight up
uniform mat3 u_background_rays;     // takes (x, y, 1), px, to the background's axes: right, up, front
uniform sampler2D u_behind;         // PANORAMA: equirectangular; BEHIND: px for px

// By hand, since texture units keep only 8 bits of where between two pixels a point lies.
vec3 panorama(vec3 ray) {
    ivec2 size = textureSize(u_behind, 0);
    float turn = atan(ray.x, ray.z) * 0.15915494309 + 0.5;
    float fall = 0.5 - atan(ray.y, length(ray.xz)) * 0.31830988618;
    vec2 place = vec2(turn * float(size.x) - 0.5, clamp(fall * float(size.y) - 0.5, 0.0, float(size.y - 1)));
    vec2 corner = floor(place), part = place - corner;
    int left = (int(corner.x) + size.x) % size.x, right = (left + 1) % size.x;
    int top = int(corner.y), bottom = min(top + 1, size.y - 1);
    vec3 above = mix(texelFetch(u_behind, ivec2(left, top), 0).rgb, texelFetch(u_behind, ivec2(right, top), 0).rgb, part.x);
    vec3 below = mix(texelFetch(u_behind, ivec2(left, bottom), 0).rgb, texelFetch(u_behind, ivec2(right, bottom), 0).rgb, part.x);
    return mix(above, below, part.y);
}

// At the pixel whose centre is `pixel`, px from the picture's top left.
vec3 background(vec2 pixel) {
    if (BEHIND) return texelFetch(u_behind, ivec2(pixel), 0).rgb;
    vec3 ray = u_background_rays * vec3(pixel, 1.0);
    if (PANORAMA) return panorama(ray);
    if (GRADIENT) return mix(u_background, u_top, 0.5 + 0.5 * ray.y / length(ray));
    return u_background;
}
