#version 330 core
layout(location = 0) in vec3 position;
layout(location = 1) in vec3 normal;
layout(location = 2) in float part;
uniform mat4 T_view_body;
uniform mat4 projection;
out vec3 seen_position;
out vec3 seen_normal;
flat out float seen_part;

void main() {
    vec4 in_view = T_view_body * vec4(position, 1.0);
    seen_position = in_view.xyz;
    seen_part = part;
    seen_normal = mat3(T_view_body) * normal;
    gl_Position = projection * in_view;
}
