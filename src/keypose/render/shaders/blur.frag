// One direction of a Gaussian.
uniform sampler2D source;
uniform vec2 stride;
uniform int taps;
uniform float sigma;
in vec2 at;
out vec2 result;

void main() {
    vec2 sum = vec2(0);
    float total = 0.0;
    for (int i = -taps; i <= taps; ++i) {
        float weight = exp(-0.5 * float(i * i) / (sigma * sigma));
        sum += weight * texture(source, at + float(i) * stride).rg;
        total += weight;
    }
    result = sum / total;
}
