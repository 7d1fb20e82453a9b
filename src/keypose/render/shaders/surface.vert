uniform float overlay; // 1: nearer than everything that is no overlay

in vec3 in_position;
in vec3 in_normal;
in vec2 in_uv;
in vec4 in_color;

out vec3 world;
out vec3 normal;
out vec2 uv;
out vec4 color;

void main() {
    world = in_position;
    normal = in_normal;
    uv = in_uv;
    color = in_color;
    gl_Position = clip_from_world * vec4(in_position, 1);
    if (overlay > 0.5) gl_Position.z = gl_Position.z * 0.005 - 0.995 * gl_Position.w;
}
