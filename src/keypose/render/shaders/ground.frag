// The floor: a pool of light that becomes the backdrop farther away, and a grid.
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
    vec2 away = world.xz - focus_.xz;
    float far2 = dot(away, away) / (focus_.w * focus_.w);
    float pool = 1.0 / (1.0 + far2 * far2 / 45.0);
    vec3 shown = mix(backdrop(gl_FragCoord.xy * pixels_.zw), floor_color_.rgb, pool);

    vec2 at = world.xz / key_color_.w;
    vec2 footprint = max(abs(dFdx(at)), abs(dFdy(at))) * 1.25 + 1e-5;
    float strong = lines(at, footprint, 0.016);
    float weak = lines(at * 5.0, footprint * 5.0, 0.034);
    weak *= 1.0 - smoothstep(0.08, 0.35, 5.0 * max(footprint.x, footprint.y));
    float fade = 1.0 / (1.0 + far2 * far2 / 19.0);
    shown = mix(shown, grid_color_.rgb, clamp((strong + 0.30 * weak) * fade, 0.0, 1.0) * fill_.w);
    result = vec4(shown + dither(gl_FragCoord.xy), 1.0);
}
