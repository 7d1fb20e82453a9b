// Supersampling: the mean of a block of pixels.
uniform sampler2D source;
uniform int block;
out vec4 result;

void main() {
    ivec2 corner = ivec2(gl_FragCoord.xy) * block;
    vec4 sum = vec4(0);
    for (int y = 0; y < block; ++y) {
        for (int x = 0; x < block; ++x) sum += texelFetch(source, corner + ivec2(x, y), 0);
    }
    result = sum / float(block * block);
}
