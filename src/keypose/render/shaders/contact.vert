// Seen from below: how near to the floor the lowest surface is.
in vec3 in_position;
out float height;

void main() {
    height = (in_position.y - forward_.w) / (0.22 * center_.w);
    gl_Position = vec4((in_position.xz - center_.xz) / (1.15 * center_.w), clamp(height, 0.0, 1.0) * 2.0 - 1.0, 1);
}
