#version 330 core
// Writes the number of the triangle instead of a colour for each object: color carries the body's first id in base 256.
uniform vec3 color;
out vec4 frag_color;

void main() {
    ivec3 digits = ivec3(round(color * 255.0));
    int id = digits.r + (digits.g << 8) + (digits.b << 16) + gl_PrimitiveID;
    frag_color = vec4(id & 255, (id >> 8) & 255, (id >> 16) & 255, 255) / 255.0;
}
