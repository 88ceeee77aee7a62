// Real spherical harmonics to degree SH_DEGREE (0 to 3), in the sign convention of trained files:
// band 1 is -C1 y, +C1 z, -C1 x (Kerbl et al. 2023). Flag: SH_DEGREE.

// The includer defines where coefficients lie and how many bands a splat has; a place means what it chooses.
uint sh_place(uint splat);
int sh_own_degree(uint place);
vec3 sh_coefficient(uint place, int index);

// 0.5 + SH of `splat` in unit direction `d` from the eye; not clamped, so that NaN can still be detected.
vec3 sh_colour(uint splat, vec3 d) {
    uint place = sh_place(splat);
    int degree = min(SH_DEGREE, sh_own_degree(place));
    vec3 colour = vec3(0.5) + 0.28209479177387814 * sh_coefficient(place, 0);
    if (degree >= 1) {
        const float C1 = 0.4886025119029199;
        colour += -C1 * d.y * sh_coefficient(place, 1);
        colour += C1 * d.z * sh_coefficient(place, 2);
        colour += -C1 * d.x * sh_coefficient(place, 3);
    }
    vec3 dd = d * d;
    if (degree >= 2) {
        colour += 1.0925484305920792 * d.x * d.y * sh_coefficient(place, 4);
        colour += -1.0925484305920792 * d.y * d.z * sh_coefficient(place, 5);
        colour += 0.31539156525252005 * (2.0 * dd.z - dd.x - dd.y) * sh_coefficient(place, 6);
        colour += -1.0925484305920792 * d.x * d.z * sh_coefficient(place, 7);
        colour += 0.5462742152960396 * (dd.x - dd.y) * sh_coefficient(place, 8);
    }
    if (degree >= 3) {
        colour += -0.5900435899266435 * d.y * (3.0 * dd.x - dd.y) * sh_coefficient(place, 9);
        colour += 2.890611442640554 * d.x * d.y * d.z * sh_coefficient(place, 10);
        colour += -0.4570457994644658 * d.y * (4.0 * dd.z - dd.x - dd.y) * sh_coefficient(place, 11);
        colour += 0.3731763325901154 * d.z * (2.0 * dd.z - 3.0 * dd.x - 3.0 * dd.y) * sh_coefficient(place, 12);
        colour += -0.4570457994644658 * d.x * (4.0 * dd.z - dd.x - dd.y) * sh_coefficient(place, 13);
        colour += 1.445305721320277 * d.z * (dd.x - dd.y) * sh_coefficient(place, 14);
        colour += -0.5900435899266435 * d.x * (dd.x - 3.0 * dd.y) * sh_coefficient(place, 15);
    }
    return colour;
}
