// The key light's depth map.
in vec3 in_position;
in vec2 in_uv;
out vec2 uv;

void main() {
    uv = in_uv;
    gl_Position = light_from_world * vec4(in_position, 1);
}
