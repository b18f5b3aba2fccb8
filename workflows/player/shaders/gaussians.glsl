// Projects one Gaussian a texel (EWA splatting as in rasterizer/math/gaussian.h): where its picture is, and the two rows of numbers that
// give alpha at a pixel as 2^(log2 opacity - u^2 - v^2) with u = f.x dx + f.y dy, v = f.z dy.
uniform highp sampler2D uMeans;  // xyz, opacity
uniform highp sampler2D uTurns;  // unit quaternion w x y z
uniform highp sampler2D uScales;  // standard deviations

layout(location = 0) out highp uvec4 oPlace;  // centre px, f.xy
layout(location = 1) out highp uvec4 oLook;  // f.z, log2 opacity, colour

void main() {
    oPlace = oLook = uvec4(0u);
    ivec2 texel = ivec2(gl_FragCoord.xy);
    int i = texel.y * WIDTH + texel.x - uFirst;
    if (i < 0 || i >= uCount) discard;
    vec4 meanAndOpacity = texelFetch(uMeans, place(i), 0);
    vec3 mean = meanAndOpacity.xyz;
    float opacity = meanAndOpacity.w;
#ifdef LIVES
    vec4 turned;
    if (i >= uStill) turned = lived(i - uStill, mean, opacity);
#endif
    if (opacity < LEAST_ALPHA) return;
    vec4 quat = texelFetch(uTurns, place(i), 0);
    vec3 scale = texelFetch(uScales, place(i), 0).xyz;
#ifdef LIVES
    if (i >= uStill) quat = composed(turned, quat);
#endif
#ifdef NODES
    if (i >= uStill) {
        vec4 links = texelFetch(uLinks, place(i - uStill), 0), weights = texelFetch(uWeights, place(i - uStill), 0);
        mean = carried(links, weights, mean);
        quat = composed(blended(links, weights), quat);
    }
#endif
#ifdef PATHS
    if (i >= uStill) {
        int at = 3 * (i - uStill);
        mean += mix(texelFetch(uKey, place(at), 0).xyz, texelFetch(uNextKey, place(at), 0).xyz, uBetween);
        quat = composed(normalize(mix(texelFetch(uKey, place(at + 1), 0), texelFetch(uNextKey, place(at + 1), 0), uBetween)), quat);
        scale *= exp(mix(texelFetch(uKey, place(at + 2), 0).xyz, texelFetch(uNextKey, place(at + 2), 0).xyz, uBetween));
    }
#endif
    vec3 away = mean - uEye, p = uRotation * away;
    if (!(p.z >= uNear)) return;

    vec2 focal = uLens.xy, slope = p.xy / p.z, centre = focal * slope + uLens.zw;
    vec2 margin = 0.3 * uSize / (2.0 * focal);
    slope = clamp(slope, -uLens.zw / focal - margin, (uSize - uLens.zw) / focal + margin);
    mat3 across = transpose(uRotation);  // its columns are the rows of the rotation
    vec3 t0 = focal.x / p.z * (across[0] - slope.x * across[2]), t1 = focal.y / p.z * (across[1] - slope.y * across[2]);
    vec4 back = vec4(quat.x, -quat.yzw);
    vec3 b0 = rotated(back, t0) * scale, b1 = rotated(back, t1) * scale;
    float xx = dot(b0, b0), xy = dot(b0, b1), yy = dot(b1, b1);
    vec3 normal = cross(b0, b1);
    // A sum of squares, so that needle-shaped Gaussians suffer no cancellation.
    float area2 = dot(normal, normal), det = area2 + DILATION * (xx + yy) + DILATION * DILATION;
#ifdef ANTIALIASED
    opacity *= sqrt(area2 / det) * fade(p.z);
#endif
    float reach2 = log2(opacity / LEAST_ALPHA);  // u^2 + v^2 where alpha falls below the least
    if (!(reach2 > 0.0)) return;
    xx += DILATION, yy += DILATION;
    vec2 extent = sqrt(vec2(xx, yy) * reach2 / (0.5 * LOG2_E));
    if (any(lessThan(centre + extent, vec2(0.0))) || any(greaterThan(centre - extent, uSize))) return;
    float half_ = sqrt(0.5 * LOG2_E), side = sqrt(yy), inverse = inversesqrt(det);
    vec3 f = half_ * vec3(side * inverse, -xy / side * inverse, 1.0 / side);
    vec3 colour = colourOf(i, normalize(away));
    oPlace = floatBitsToUint(vec4(centre, f.xy));
    oLook = uvec4(floatBitsToUint(f.z), floatBitsToUint(log2(opacity)), packHalf2x16(colour.rg), packHalf2x16(vec2(colour.b, 0.0)));
}
