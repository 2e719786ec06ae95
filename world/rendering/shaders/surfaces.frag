#version 330 core
// Depth along the optical axis, number of the body plus that of its part, and the normal's x and y in the view's frame; where its z is positive, the
// number is negative.
uniform float number;
uniform bool two_sided;
in vec3 seen_position;
in vec3 seen_normal;
flat in float seen_part;
out vec4 surface;

void main() {
    vec3 normal = normalize(two_sided && !gl_FrontFacing ? -seen_normal : seen_normal);
    float code = number + seen_part;
    surface = vec4(seen_position.z, normal.z > 0.0 ? -code : code, normal.xy);
}
