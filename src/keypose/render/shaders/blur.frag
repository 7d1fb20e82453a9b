// One direction of a Gaussian; every tap but the middle one reads two texels between which the sampler interpolates.
uniform sampler2D source;
uniform vec2 stride;
uniform int taps;
uniform vec2 kernel[8]; // offset in texels, weight

in vec2 at;
out vec2 result;

void main() {
    result = kernel[0].y * texture(source, at).rg;
    for (int i = 1; i < taps; ++i) {
        vec2 away = kernel[i].x * stride;
        result += kernel[i].y * (texture(source, at + away).rg + texture(source, at - away).rg);
    }
}
