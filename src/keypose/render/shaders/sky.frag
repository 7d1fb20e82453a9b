in vec2 at;
out vec4 result;

void main() {
    result = vec4(backdrop(at) + dither(gl_FragCoord.xy), 1.0);
}
