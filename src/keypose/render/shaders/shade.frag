// The subject's shadow on the floor: crisp where it touches, soft where it is high, and dark under what is near.
uniform sampler2D near_cover; // little blurred: coverage, coverage x height / 4
uniform sampler2D far_cover;  // much blurred
uniform sampler2D contact;

in vec3 world;
out vec4 result;

void main() {
    vec2 place = (light_from_world * vec4(world, 1)).xy * 0.5 + 0.5;
    vec2 crisp = texture(near_cover, place).rg, soft = texture(far_cover, place).rg;
    float gap = 4.0 * soft.y / max(soft.x, 1e-3); // how high above the floor, along the light, the cover is
    float dark = mix(crisp.x, soft.x, smoothstep(0.02, 0.8, gap)) * mix(0.78, 0.5, smoothstep(0.1, 1.6, gap));
    vec2 below = (world.xz - center_.xz) / (1.15 * center_.w) * 0.5 + 0.5;
    dark = 1.0 - (1.0 - dark) * (1.0 - 0.75 * texture(contact, below).r);
    result = vec4(shadow_color_.rgb * dark, dark);
}
