#version 330 core
// The id of the triangle plus one: number is that of the body's first triangle.
uniform float number;
out vec4 face;

void main() {
    face = vec4(number + float(gl_PrimitiveID), 0.0, 0.0, 0.0);
}
