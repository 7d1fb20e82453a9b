uniform sampler2D base_texture;
uniform vec4 base_color;
uniform int masked;
uniform float cutoff;
in vec2 uv;

void main() {
    if (masked == 1 && base_color.a * texture(base_texture, uv).a < cutoff) discard;
}
