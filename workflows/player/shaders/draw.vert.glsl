// A parallelogram (Gaussian) or box (convex) that holds every pixel where the primitive's alpha is above the least.
const int WIDTH = 4096;
uniform highp usampler2D uPlace;
uniform highp usampler2D uLook;
uniform vec2 uSize;
uniform int uGaussians;
uniform lowp sampler2D uClosed;  // a texel for each tile
uniform highp usampler2D uOrder;

out highp vec2 vAt;  // Gaussian: u, v; convex: px from the corner of its box
flat out highp vec4 vLook;  // colour; log2 opacity, or opacity
#ifdef CONVEXES
flat out highp float vRho;  // convex: kappa / tau
flat out highp float vShared;  // convex: what all its lines share
flat out highp int vEdges;  // convex: its first edge; -1 for a Gaussian
#else
float vRho, vShared;
int vEdges;
#endif

// Whether the box from `low` to `high`, px, lies in closed tiles alone; only few are looked at.
bool hidden(vec2 low, vec2 high) {
    low.y = uSize.y - low.y, high.y = uSize.y - high.y;  // the picture's rows count from its foot here
    ivec2 last = textureSize(uClosed, 0) - 1, from = ivec2(clamp(vec2(low.x, high.y), vec2(0.0), uSize)) / TILE;
    ivec2 to = ivec2(clamp(vec2(high.x, low.y), vec2(0.0), uSize)) / TILE;
    from = min(from, last), to = min(to, last);
    if (to.x - from.x > 4 || to.y - from.y > 4) return false;
    for (int y = from.y; y <= to.y; ++y)
        for (int x = from.x; x <= to.x; ++x)
            if (texelFetch(uClosed, ivec2(x, y), 0).r < 0.5) return false;
    return true;
}

void main() {
    int k = gl_VertexID >> 2;
    int i = int(texelFetch(uOrder, ivec2(k % WIDTH, k / WIDTH), 0).x);
    ivec2 texel = ivec2(i % WIDTH, i / WIDTH);
    uvec4 place = texelFetch(uPlace, texel, 0), look = texelFetch(uLook, texel, 0);
    vec2 corner = vec2(gl_VertexID & 1, gl_VertexID >> 1 & 1);
    vec4 at = uintBitsToFloat(place);
    float first = uintBitsToFloat(look.x), second = uintBitsToFloat(look.y);
    vec2 last = unpackHalf2x16(look.w);
    vLook = vec4(unpackHalf2x16(look.z), last.x, second);
    vShared = last.y;
    vRho = first;
    vec2 px;
    bool gone = false;
    if (look.x == 0u) {  // nothing of it is in the picture
        px = vec2(-2.0) * uSize, vAt = vec2(0.0), vEdges = -1;
    } else if (i < uGaussians) {
        float reach = sqrt(second + 7.994353436858858);  // log2 255
        vec2 extent = reach / vec2(at.z, first) * vec2(sqrt(1.0 + at.w * at.w / (first * first)), 1.0);
        gone = hidden(at.xy - extent, at.xy + extent);
        vAt = (2.0 * corner - 1.0) * reach;
        float dy = vAt.y / first;
        px = at.xy + vec2((vAt.x - at.w * dy) / at.z, dy);
        vEdges = -1;
    } else {
        gone = hidden(at.xy, at.zw);
        px = mix(at.xy, at.zw, corner);
        vAt = px - at.xy;
        vEdges = (i - uGaussians) * CORNERS;
    }
    if (gone) px = vec2(-2.0) * uSize;
    gl_Position = vec4(px / uSize * vec2(2.0, -2.0) + vec2(-1.0, 1.0), 0.0, 1.0);
}
