// The backdrop as it was drawn before, for a camera that stands still.
uniform sampler2D source;
out vec4 result;

void main() {
    result = texelFetch(source, ivec2(gl_FragCoord.xy), 0);
}
