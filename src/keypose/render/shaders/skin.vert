// Linear-blend skinning, once per vertex and picture; the result is kept in a buffer that all passes draw from.
uniform sampler2D palette; // three texels (rows of an affine matrix) per joint, 64 joints per line
uniform int first;         // of this part's joints in the palette

in vec3 in_position;
in vec3 in_normal;
in ivec4 in_joints;
in vec4 in_weights;
#ifdef EIGHT
in ivec4 in_joints_more;
in vec4 in_weights_more;
#endif

out vec3 out_position;
out vec3 out_normal;

void add(int joint, float weight, inout vec4 x, inout vec4 y, inout vec4 z) {
    int at = first + joint;
    ivec2 texel = ivec2(3 * (at & 63), at >> 6);
    x += weight * texelFetch(palette, texel, 0);
    y += weight * texelFetch(palette, texel + ivec2(1, 0), 0);
    z += weight * texelFetch(palette, texel + ivec2(2, 0), 0);
}

void main() {
    vec4 x = vec4(0), y = vec4(0), z = vec4(0);
    for (int k = 0; k < 4; ++k) {
        add(in_joints[k], in_weights[k], x, y, z);
    }
#ifdef EIGHT
    for (int k = 0; k < 4; ++k) {
        add(in_joints_more[k], in_weights_more[k], x, y, z);
    }
#endif
    vec4 position = vec4(in_position, 1);
    out_position = vec3(dot(x, position), dot(y, position), dot(z, position));
    vec3 normal = vec3(dot(x.xyz, in_normal), dot(y.xyz, in_normal), dot(z.xyz, in_normal)); // no translation
    float size = length(normal);
    out_normal = size > 0.0 ? normal / size : vec3(0);
}
