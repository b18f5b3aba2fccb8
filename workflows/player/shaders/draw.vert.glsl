// A parallelogram (Gaussian) or box (convex) that holds every pixel where the primitive's alpha is above the least.
const int WIDTH = 4096;
uniform highp usampler2D uPlace;
uniform highp usampler2D uLook;
uniform vec2 uSize;
uniform int uGaussians;
layout(location = 0) in uint aPrimitive;

out highp vec2 vAt;         // Gaussian: u, v; convex: px from the corner of its box
flat out highp vec4 vLook;  // colour; log2 opacity, or opacity
flat out highp float vRho;  // convex: kappa / tau
flat out highp int vEdges;  // convex: its first edge; -1 for a Gaussian

void main() {
    int i = int(aPrimitive);
    ivec2 texel = ivec2(i % WIDTH, i / WIDTH);
    uvec4 place = texelFetch(uPlace, texel, 0), look = texelFetch(uLook, texel, 0);
    vec2 corner = vec2(gl_VertexID & 1, gl_VertexID >> 1);
    vec4 at = uintBitsToFloat(place);
    float first = uintBitsToFloat(look.x), second = uintBitsToFloat(look.y);
    vLook = vec4(unpackHalf2x16(look.z), unpackHalf2x16(look.w).x, second);
    vRho = first;
    vec2 px;
    if (look.x == 0u) {  // nothing of it is in the picture
        px = vec2(-2.0) * uSize, vAt = vec2(0.0), vEdges = -1;
    } else if (i < uGaussians) {
        vAt = (2.0 * corner - 1.0) * sqrt(second + 7.994353436858858);  // log2 255
        float dy = vAt.y / first;
        px = at.xy + vec2((vAt.x - at.w * dy) / at.z, dy);
        vEdges = -1;
    } else {
        px = mix(at.xy, at.zw, corner);
        vAt = px - at.xy;
        vEdges = (i - uGaussians) * CORNERS;
    }
    gl_Position = vec4(px / uSize * vec2(2.0, -2.0) + vec2(-1.0, 1.0), 0.0, 1.0);
}
