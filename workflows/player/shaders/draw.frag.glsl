// The alpha of a primitive at a pixel. Blending is front to back: the target's alpha is what still shines through.
in highp vec2 vAt;
flat in highp vec4 vLook;
#ifdef CONVEXES
flat in highp float vRho;
flat in highp float vShared;
flat in highp int vEdges;
uniform highp usampler2D uEdges;
#endif
out highp vec4 oColour;

const int WIDTH = 4096;

void main() {
    float alpha = exp2(vLook.a - dot(vAt, vAt));
#ifdef CONVEXES
    if (vEdges >= 0) {
        float lines[CORNERS], top = -1e30, sum = 0.0;
        for (int k = 0; k < CORNERS; ++k) {
            int at = vEdges + k;
            vec3 line = uintBitsToFloat(texelFetch(uEdges, ivec2(at % WIDTH, at / WIDTH), 0)).xyz;
            lines[k] = dot(line.xy, vAt) + line.z;
            top = max(top, lines[k]);
        }
        for (int k = 0; k < CORNERS; ++k) sum += exp2(max(lines[k] - top, -60.0));
        alpha = vLook.a / (1.0 + exp2(clamp(vRho * (top + log2(sum) + vShared), -60.0, 60.0)));
    }
#endif
    alpha = alpha < 1.0 / 255.0 ? 0.0 : min(alpha, 0.99);  // not discarded, so that the depth test may come first
    oColour = vec4(vLook.rgb * alpha, alpha);
}
