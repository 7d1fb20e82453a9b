uniform sampler2D base_texture;
uniform sampler2DShadow depth_map;
uniform vec4 base_color;
uniform vec3 emissive;
uniform vec4 surface; // metallic, roughness, alpha cutoff (negative: none), opacity
uniform ivec4 flags;  // unlit, flat, overlay, ghost
uniform vec4 tint;    // colour and strength

in vec3 world;
in vec3 normal;
in vec2 uv;
in vec4 color;
out vec4 result;

float sunlit(vec3 at, vec3 n) {
    if (key_.w < 0.5) return 1.0;
    float texel = 2.0 * center_.w / float(textureSize(depth_map, 0).x);
    float slope = 1.0 - clamp(dot(n, key_.xyz), 0.0, 1.0);
    vec3 moved = at + n * texel * (1.2 + 2.2 * slope) + key_.xyz * texel * 0.8;
    vec3 place = (light_from_world * vec4(moved, 1)).xyz * 0.5 + 0.5;
    if (any(lessThan(place, vec3(0))) || any(greaterThan(place, vec3(1)))) return 1.0;
    float stride = 1.6 / float(textureSize(depth_map, 0).x);
    float sum = 0.0;
    for (int y = -1; y <= 1; ++y) {
        for (int x = -1; x <= 1; ++x) {
            float weight = float((2 - abs(x)) * (2 - abs(y)));
            sum += weight * texture(depth_map, vec3(place.xy + vec2(x, y) * stride, place.z));
        }
    }
    return sum / 16.0;
}

vec3 tone(vec3 c) { // Khronos PBR Neutral: keeps base colours, bends only the highlights
    float low = min(c.r, min(c.g, c.b));
    c -= low < 0.08 ? low - 6.25 * low * low : 0.04;
    float peak = max(c.r, max(c.g, c.b));
    if (peak < 0.76) return c;
    float bent = 1.0 - 0.0576 / (peak + 0.24 - 0.76);
    c *= bent / peak;
    return mix(vec3(bent), c, 1.0 / (0.15 * (peak - bent) + 1.0));
}

vec3 lit(vec3 base, float metallic, float roughness, vec3 n, vec3 v, float sun, float height) {
    float facing = dot(n, key_.xyz);
    float nv = max(dot(n, v), 1e-3);
    float key = clamp((facing + 0.12) / 1.12, 0.0, 1.0) * sun;
    float fill = clamp(dot(n, fill_.xyz) * 0.5 + 0.5, 0.0, 1.0);
    float up = n.y * 0.5 + 0.5;
    float open = mix(0.62 + 0.38 * up, 1.0, height); // near the floor what looks down sees less light
    vec3 ambient = mix(ground_ambient_.rgb, sky_ambient_.rgb, up) * open;
    vec3 diffuse = base * (1.0 - metallic) * (key_color_.rgb * key + fill_color_.rgb * fill * fill + ambient);

    vec3 f0 = mix(vec3(0.04), base, metallic);
    float alpha = max(roughness * roughness, 0.02);
    vec3 h = normalize(key_.xyz + v);
    float nh = max(dot(n, h), 0.0), vh = max(dot(v, h), 0.0), nl = max(facing, 0.0);
    float a2 = alpha * alpha;
    float spread = nh * nh * (a2 - 1.0) + 1.0;
    float lobe = a2 / (spread * spread) / (4.0 * mix(vh * vh, 1.0, 0.5 * alpha + 0.25)); // GGX, Kelemen visibility
    vec3 fresnel = f0 + (1.0 - f0) * pow(1.0 - vh, 5.0);
    vec3 shine = key_color_.rgb * fresnel * min(lobe, 12.0) * nl * sun;
    // the studio around the subject: a bright ceiling over a darker floor, blurred by the roughness
    vec3 r = reflect(-v, n);
    float edge = mix(0.18, 0.9, roughness);
    vec3 around = mix(ground_ambient_.rgb, sky_ambient_.rgb * 1.35, smoothstep(-edge, edge, r.y));
    vec3 grazing = f0 + (max(vec3(1.0 - roughness), f0) - f0) * pow(1.0 - nv, 5.0);
    shine += around * grazing * open;
    float rim = pow(1.0 - nv, 3.0) * smoothstep(-0.25, 0.75, dot(n, rim_.xyz));
    return diffuse + shine + rim_color_.rgb * rim * mix(vec3(0.35), base + 0.15, 0.6);
}

void main() {
    vec4 base = base_color * color * texture(base_texture, uv);
    if (base.a < surface.z) discard;
    float alpha = surface.z >= 0.0 ? 1.0 : base.a;
    vec3 n = flags.y == 1 ? cross(dFdx(world), dFdy(world)) : normal;
    n = normalize(n);
    vec3 v = eye_.w > 0.5 ? -forward_.xyz : normalize(eye_.xyz - world);
    if (flags.y == 1 ? dot(n, v) < 0.0 : !gl_FrontFacing) n = -n;
    vec3 shown;
    if (flags.x == 1) {
        shown = base.rgb;
    } else {
        float sun = flags.z == 1 || dot(n, key_.xyz) < -0.12 ? 1.0 : sunlit(world, n); // not where no key light falls
        float height = smoothstep(0.0, 0.45, (world.y - forward_.w) / center_.w);
        shown = tone(lit(base.rgb, surface.x, surface.y, n, v, sun, height) + emissive);
    }
    if (flags.w == 1) { // a ghost: its rim says more than its surface
        shown = mix(shown, tint.rgb, tint.a);
        alpha *= mix(0.55, 1.0, pow(1.0 - max(dot(n, v), 0.0), 1.5));
    }
    alpha *= surface.w;
    result = vec4(encode(shown) * alpha, alpha);
}
