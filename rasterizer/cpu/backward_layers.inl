// The backward pass of one layer of a tile: sums the terms of its gradients over the pixels. Each kind of primitive has its own function,
// so that it can use all registers. Included by blend.inl.

struct TileGrads {  // pixels in the order of TilePixels
    alignas(64) float transmittance[kPixels], behind[kPixels];
    alignas(64) float red[kPixels], green[kPixels], blue[kPixels];
    alignas(64) float z[kPixels], depth[kPixels];  // z: gradient of sum w z, which is depth's gradient / alpha; depth = sum w z / alpha
    alignas(64) int32_t last[kPixels];
};

struct Walk {  // the state of the backward pass that all layers share
    TileGrads* px;
    const float* extra;  // [extras, kPixels] gradients of the image's extras
    float* extra_sums;   // [extras, 16] sums for the layer's extras
    int extras;
};

// The part that both kinds share, at one vector of pixels. Returns g = dL/dalpha alpha where alpha is not capped, else 0.
template <bool DEPTH, bool EXTRAS>
__attribute__((always_inline)) inline Float layer_backward(const Walk& walk, int at, const Item& item, int32_t index, Float raw, Mask counted,
                                                           Float* sums) {
    TileGrads& px = *walk.px;
    const Mask live = counted & (load(px.last + at) >= set1(index));
    const Float alpha = keep(live, min(raw, set1(kMaxAlpha)));
    const Float inverse = reciprocal(set1(1.0f) - alpha);
    const Float before = load(px.transmittance + at) * inverse, behind = load(px.behind + at);
    const Float w = before * alpha;
    const Float red = load(px.red + at), green = load(px.green + at), blue = load(px.blue + at);
    Float f = fma(red, set1(item.color[0]), fma(green, set1(item.color[1]), blue * set1(item.color[2])));
    sums[0] = fma(w, red, sums[0]);
    sums[1] = fma(w, green, sums[1]);
    sums[2] = fma(w, blue, sums[2]);
    if constexpr (DEPTH) {
        const Float z = load(px.z + at);
        // Depth is a weighted mean, so a layer changes it by its own distance from the mean, while everything behind, taken together, does
        // not. Written as two large terms, each divided by a small alpha, the gradient of a faint pixel would be rounding noise.
        f = fma(z, set1(item.z) - load(px.depth + at), f);
        sums[3] = fma(w, z, sums[3]);
    }
    if constexpr (EXTRAS)
        for (int e = 0; e < walk.extras; ++e) {
            const Float g = load(walk.extra + kPixels * e + at);
            if (item.extras) f = fma(g, set1(item.extras[e]), f);
            float* sum = walk.extra_sums + 16 * e;
            store(sum, fma(w, g, load(sum)));
        }
    store(px.transmittance + at, before);
    store(px.behind + at, fma(w, f, behind));
    return keep(raw < set1(kMaxAlpha), alpha * fnma(behind, inverse, before * f));
}

// Unrolled by hand, because the compiler would use a string instruction, which takes longer to start than to run.
template <int N>
__attribute__((always_inline)) inline void clear(Float* v) {
#pragma GCC unroll 32
    for (int i = 0; i < N; ++i) v[i] = zero();
}

// out [16]: sums of colour 3, z, then g (1, u, v, uu, uv, vv).
template <bool DEPTH, bool EXTRAS>
__attribute__((noinline)) void gaussian_layer(const Walk& walk, const Item& item, int32_t index, uint32_t mask, float* out) {
    Float sums[10];
    clear<10>(sums);
    for (; mask; mask &= mask - 1) {
        const int b = __builtin_ctz(mask);
        for (int k = 0; k < kVectors; ++k) {
            const Float X = load(kLaneX + k * kWidth) + set1(float(b % kSide * kBlock));
            const Float Y = load(kLaneY + k * kWidth) + set1(float(b / kSide * kBlock));
            Mask counted;
            Float u, v;
            const Float raw = gaussian_alpha(item, X, Y, u, v, counted);
            const Float g = layer_backward<DEPTH, EXTRAS>(walk, 16 * b + k * kWidth, item, index, raw, counted, sums);
            const Float gu = g * u, gv = g * v;
            sums[4] = sums[4] + g;
            sums[5] = sums[5] + gu;
            sums[6] = sums[6] + gv;
            sums[7] = fma(gu, u, sums[7]);
            sums[8] = fma(gu, v, sums[8]);
            sums[9] = fma(gv, v, sums[9]);
        }
    }
    sum_lanes<10>(sums, out);
}
