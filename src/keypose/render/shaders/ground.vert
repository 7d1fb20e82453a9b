out vec3 world;

void main() {
    vec2 corner = vec2(gl_VertexID & 1, gl_VertexID >> 1) * 2.0 - 1.0;
    // a hair lower than the floor, so that things that lie on it do not flicker
    world = vec3(focus_.x, forward_.w - 0.0015 * focus_.w, focus_.z) + vec3(corner.x, 0, corner.y) * 40.0 * focus_.w;
    gl_Position = clip_from_world * vec4(world, 1);
}
