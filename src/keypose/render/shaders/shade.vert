// The part of the floor that the key light's box throws its shadow on.
out vec3 world;

void main() {
    vec2 corner = vec2(gl_VertexID & 1, gl_VertexID >> 1) * 2.0 - 1.0;
    vec3 from = (world_from_light * vec4(corner * 1.1, -1.0, 1.0)).xyz;
    world = from - key_.xyz * ((from.y - forward_.w) / key_.y);
    // between the floor and what lies on it
    gl_Position = clip_from_world * vec4(world.x, world.y - 0.001 * focus_.w, world.z, 1);
}
