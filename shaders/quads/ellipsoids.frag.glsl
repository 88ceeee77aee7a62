// Intersection of the pixel's ray with the ellipsoid: depth, normal, and shading by a lamp at the eye.
// Flag: ORTHOGRAPHIC.
uniform vec2 u_focal;
uniform vec2 u_principal;
uniform float u_near;
uniform float u_depth_unit;  // world units; depths about it keep the most digits

flat in mat3 v_to_sphere;
flat in vec3 v_centre;
flat in vec3 v_colour;
out vec4 colour;

const float AMBIENT = 0.3;

void main() {
    vec2 place = (gl_FragCoord.xy - u_principal) / u_focal;
    vec3 ray = vec3(ORTHOGRAPHIC ? vec2(0.0) : place, 1.0);
    vec3 centre = v_centre;
    if (ORTHOGRAPHIC) centre -= v_to_sphere * vec3(place, 0.0);
    // |e z - centre| = 1; the discriminant as |e|² - |e x c|², which keeps its digits on thin ellipsoids.
    vec3 e = v_to_sphere * ray;
    vec3 moment = cross(e, centre);
    float ee = dot(e, e);
    float discriminant = ee - dot(moment, moment);
    if (!(discriminant >= 0.0)) discard;
    float z = (dot(e, centre) - sqrt(discriminant)) / ee;
    if (!(z >= u_near)) discard;
    vec3 normal = normalize((e * z - centre) * v_to_sphere);
    float facing = max(-dot(normal, normalize(ray)), 0.0);
    colour = vec4(v_colour * (AMBIENT + (1.0 - AMBIENT) * facing), 0.0);
    gl_FragDepth = z / (z + u_depth_unit);
}
