// Perceptual colour maps as polynomials of degree 6, fitted by least squares to matplotlib's tables (CC0);
// largest error 0.05. `t` in [0, 1].

vec3 viridis(float t) {
    vec3 sum = vec3(-5.432077, 4.641571, 26.272108);
    sum = sum * t + vec3(4.751787, -13.749439, -65.320968);
    sum = sum * t + vec3(6.203736, 14.153965, 56.656300);
    sum = sum * t + vec3(-4.599932, -5.758238, -19.291809);
    sum = sum * t + vec3(-0.327241, 0.214814, 0.091977);
    sum = sum * t + vec3(0.107708, 1.396470, 1.386771);
    sum = sum * t + vec3(0.274455, 0.005768, 0.332664);
    return clamp(sum, 0.0, 1.0);
}

vec3 inferno(float t) {
    vec3 sum = vec3(25.092619, -12.222155, -23.115650);
    sum = sum * t + vec3(-71.287667, 32.553880, 73.588132);
    sum = sum * t + vec3(77.157454, -33.415679, -82.253923);
    sum = sum * t + vec3(-41.709277, 17.457724, 44.645117);
    sum = sum * t + vec3(11.617115, -3.947723, -16.257323);
    sum = sum * t + vec3(0.105874, 0.566364, 4.117926);
    sum = sum * t + vec3(0.000214, 0.001635, -0.037130);
    return clamp(sum, 0.0, 1.0);
}
