#version 330 core
// Position and normal in the view's frame; the number of the body goes beside the position.
uniform float part;
uniform bool two_sided;
in vec3 seen_position;
in vec3 seen_normal;
layout(location = 0) out vec4 position_part;
layout(location = 1) out vec4 normal;

void main() {
    position_part = vec4(seen_position, part);
    normal = vec4(two_sided && !gl_FrontFacing ? -seen_normal : seen_normal, 0.0);
}
