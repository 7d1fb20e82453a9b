// What every shader knows of the picture; `keypose.render.frame` packs it, and the software backend reads the same.
layout(std140) uniform Frame {
    mat4 clip_from_world;
    mat4 world_from_clip;
    mat4 light_from_world;
    mat4 world_from_light;
    vec4 eye_;       // w: 1 for an orthographic camera
    vec4 forward_;   // w: height of the floor
    vec4 key_;       // w: 1 with shadows
    vec4 fill_;      // w: strength of the grid
    vec4 rim_;       // w: 1 without a backdrop
    vec4 center_;    // w: radius of the subject
    vec4 focus_;     // w: reach of everything shown
    vec4 key_color_; // w: metres between strong grid lines
    vec4 fill_color_;
    vec4 rim_color_;
    vec4 sky_ambient_;
    vec4 ground_ambient_;
    vec4 zenith_;     // from here on colours as they are shown (sRGB): the backdrop is mixed without light
    vec4 horizon_;
    vec4 floor_color_;
    vec4 grid_color_;
    vec4 shadow_color_;
    vec4 pixels_;    // width, height, 1 / width, 1 / height
};

vec3 encode(vec3 linear_rgb) { // sRGB
    vec3 c = clamp(linear_rgb, 0.0, 1.0);
    return mix(12.92 * c, 1.055 * pow(max(c, 1e-6), vec3(1.0 / 2.4)) - 0.055, step(vec3(0.0031308), c));
}

float dither(vec2 pixel) { // interleaved gradient noise, half a step of 8 bits either way (Jimenez 2014)
    return (fract(52.9829189 * fract(dot(pixel, vec2(0.06711056, 0.00583715)))) - 0.5) / 255.0;
}

vec3 backdrop(vec2 at) { // at: 0..1 over the picture, origin at the bottom left
    float height = smoothstep(0.30, 1.15, at.y);
    vec2 away = (at - vec2(0.5, 0.55)) * vec2(0.55, 0.45);
    return mix(horizon_.rgb, zenith_.rgb, clamp(height * 0.85 + dot(away, away) * 0.55, 0.0, 1.0));
}
