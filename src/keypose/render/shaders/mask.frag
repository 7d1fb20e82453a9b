// What the key light's depth map covers of the floor, and how far above the floor along the light (a quarter of the radii).
uniform sampler2D depth_map;
uniform int block; // depth texels per mask texel
in vec2 at;
out vec2 cover;

void main() {
    vec4 start = world_from_light * vec4(at * 2.0 - 1.0, -1.0, 1.0);
    float floor_depth = (start.y - forward_.w) / (key_.y * 4.0 * center_.w);
    ivec2 corner = ivec2(gl_FragCoord.xy) * block;
    cover = vec2(0);
    for (int y = 0; y < block; ++y) {
        for (int x = 0; x < block; ++x) {
            float depth = texelFetch(depth_map, corner + ivec2(x, y), 0).r;
            float gap = (floor_depth - depth) * 4.0;
            if (depth < 1.0 && gap > 0.0) cover += vec2(1.0, min(0.25 * gap, 1.0));
        }
    }
    // nothing at the rim, so that nothing is smeared outwards from it
    float inside = step(abs(at.x - 0.5), 0.49) * step(abs(at.y - 0.5), 0.49);
    cover *= inside / float(block * block);
}
