// The floor: a pool of light that becomes the backdrop farther away, a grid, a soft shadow and a contact shadow.
uniform sampler2D near_cover; // little blurred: coverage, coverage x height
uniform sampler2D far_cover;  // much blurred
uniform sampler2D contact;

in vec3 world;
out vec4 result;

// Share of a grid cell's width that is line, integrated over the pixel's footprint: it fades to an even tone instead
// of turning into moire (after Quilez, "filterable procedurals").
float lines(vec2 at, vec2 footprint, float width) {
    vec2 a = at + 0.5 * footprint + 0.5 * width, b = at - 0.5 * footprint + 0.5 * width;
    vec2 share = (floor(a) * width + min(fract(a), width) - floor(b) * width - min(fract(b), width)) / footprint;
    return 1.0 - (1.0 - share.x) * (1.0 - share.y);
}

void main() {
    vec2 screen = gl_FragCoord.xy * pixels_.zw;
    vec3 behind = backdrop(screen);
    vec2 away = world.xz - focus_.xz;
    float far = length(away) / focus_.w;
    float pool = 1.0 / (1.0 + pow(far / 2.6, 4.0));
    vec3 shown = mix(behind, floor_color_.rgb, pool);

    float cell = key_color_.w;
    vec2 at = world.xz / cell;
    vec2 footprint = max(abs(dFdx(at)), abs(dFdy(at))) * 1.25 + 1e-5;
    // a line is never thinner than a pixel: it gets fainter instead
    float strong = lines(at, footprint, 0.016);
    float weak = lines(at * 5.0, footprint * 5.0, 0.034);
    float fade = 1.0 / (1.0 + pow(far / 2.1, 4.0));
    float ink = (strong + 0.30 * weak * (1.0 - smoothstep(0.08, 0.35, 5.0 * max(footprint.x, footprint.y)))) * fade;
    shown = mix(shown, grid_color_.rgb, clamp(ink, 0.0, 1.0) * fill_.w);

    float dark = 0.0;
    if (key_.w > 0.5) {
        vec2 place = (light_from_world * vec4(world, 1)).xy * 0.5 + 0.5;
        if (all(greaterThan(place, vec2(0.0))) && all(lessThan(place, vec2(1.0)))) {
            vec2 crisp = texture(near_cover, place).rg, soft = texture(far_cover, place).rg;
            float gap = soft.y / max(soft.x, 1e-4); // how high above the floor, along the light, the cover is
            dark = mix(crisp.x, soft.x, smoothstep(0.02, 0.8, gap)) * mix(0.78, 0.5, smoothstep(0.1, 1.6, gap));
        }
        vec2 below = (world.xz - center_.xz) / (1.15 * center_.w) * 0.5 + 0.5;
        if (all(greaterThan(below, vec2(0.0))) && all(lessThan(below, vec2(1.0)))) {
            dark = 1.0 - (1.0 - dark) * (1.0 - 0.75 * texture(contact, below).r);
        }
    }
    shown = mix(shown, shadow_color_.rgb, dark);
    result = vec4(encode(shown) + dither(gl_FragCoord.xy), 1.0);
    if (rim_.w > 0.5) result = vec4(encode(shadow_color_.rgb) * dark, dark);
}
