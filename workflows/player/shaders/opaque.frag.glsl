// One texel for each tile of the picture: 1 where none of its pixels shows what lies behind, so that nothing need be drawn there any more.
uniform highp sampler2D uBlended;
out highp vec4 oClosed;

void main() {
    ivec2 first = ivec2(gl_FragCoord.xy) * TILE, end = min(first + TILE, textureSize(uBlended, 0));
    oClosed = vec4(0.0);
    for (int y = first.y; y < end.y; ++y)
        for (int x = first.x; x < end.x; ++x)
            if (texelFetch(uBlended, ivec2(x, y), 0).a > 2e-3) return;
    oClosed = vec4(1.0);
}
