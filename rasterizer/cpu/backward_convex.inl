// The layer of a convex, as in backward_layers.inl. With E = 2^(rho lse) and p_i the softmax of the lines L_i, its sums after colour 3 and
// z are g, h lse and h (lse - sum_i p_i L_i), where h = -dL/d(ln E), and for each edge h p_i (X, Y, 1). The third one gives tau's
// gradient. Computed from the others, that would be a small difference of large numbers. Included by blend.inl.

// The coordinates in an edge's sums are split into the block's position, added here, and the pixel's position in the block, which is the
// same in all blocks and is added in convex_layer().
struct EdgeSums {
    Float p;     // sum h p_i
    Float x, y;  // the same, times the coordinates of the block's first pixel (in its k-th vector)
};

__attribute__((always_inline)) inline void add_edge(EdgeSums& to, Float p, Float x, Float y) {
    to.p = to.p + p;
    to.x = fma(p, x, to.x);
    to.y = fma(p, y, to.y);
}

// Blocks that lie inside the hull, where alpha depends only on the opacity.
template <bool DEPTH, bool EXTRAS>
__attribute__((noinline)) void inside_layer(const Walk& walk, const Item& item, int32_t index, uint32_t mask, float opacity, Float* sums) {
    for (; mask; mask &= mask - 1)
        for (int k = 0; k < kVectors; ++k)
            sums[4] = sums[4] + layer_backward<DEPTH, EXTRAS>(walk, 16 * __builtin_ctz(mask) + k * kWidth, item, index, set1(opacity), all(), sums);
}

// N: number of the convex's points. offset [16][kMaxPoints]: L_i - top at the blocks' centres.
template <bool DEPTH, bool EXTRAS, int N>
__attribute__((noinline)) void gentle_layer(const Walk& walk, const Item& item, const ConvexItem& convex, const float* offset, int32_t index,
                                            uint32_t mask, Float* sums, EdgeSums* edges) {
    Float own[kConvexEdges];
    EdgeSums mine[N];
    clear<kConvexEdges>(own);
    for (int e = 0; e < N; ++e) mine[e] = {zero(), zero(), zero()};
    for (; mask; mask &= mask - 1) {
        const int b = __builtin_ctz(mask);
        for (int k = 0; k < kVectors; ++k) {
            const float down = float(k * kWidth / kBlock);
            const Float x = set1(float(b % kSide * kBlock)), y = set1(float(b / kSide * kBlock) + down);
            Mask counted;
            ConvexValue<N> value;
            const Float raw = gentle_alpha(convex, b, k * kWidth, value, counted);
            const Float g = layer_backward<DEPTH, EXTRAS>(walk, 16 * b + k * kWidth, item, index, raw, counted, own);
            const Float h = g * value.outside, share = h * reciprocal(value.sum);
            own[4] = own[4] + g;
            own[5] = fma(h, value.lse, own[5]);
            Float spread = fma(h, value.spread, own[6]);
            for (int e = 0; e < N; ++e) {
                const Float p = share * value.edge[e];
                spread = fnma(p, set1(k ? offset[kMaxPoints * b + e] + down * convex.b[e] : offset[kMaxPoints * b + e]), spread);
                add_edge(mine[e], p, x, y);
            }
            own[6] = spread;
        }
    }
    const Float X = load(kLaneX) - set1(kHalf), Y = load(kLaneY) - set1(kHalf);
    for (int e = 0; e < N; ++e) {
        own[6] = fnma(mine[e].p, fma(set1(convex.a[e]), X, set1(convex.b[e]) * Y), own[6]);
        edges[e] = mine[e];
    }
#pragma GCC unroll 32
    for (int i = 0; i < kConvexEdges; ++i) sums[i] = sums[i] + own[i];
}

// N: number of bits in `those`, which marks the edges that matter in the block.
template <bool DEPTH, bool EXTRAS, int N>
__attribute__((always_inline)) inline void sharp_block(const Walk& walk, const Item& item, const ConvexItem& convex, uint32_t those, int32_t index,
                                                       int b, Float* sums, EdgeSums* edges) {
    for (int k = 0; k < kVectors; ++k) {
        const Float x = set1(float(b % kSide * kBlock)), y = set1(float(b / kSide * kBlock) + float(k * kWidth / kBlock));
        Mask counted;
        ConvexValue<N> value;
        const Float raw = sharp_alpha(convex, those, x + load(kLaneX), y + load(kLaneY), value, counted);
        const Float g = layer_backward<DEPTH, EXTRAS>(walk, 16 * b + k * kWidth, item, index, raw, counted, sums);
        const Float h = g * value.outside;
        sums[4] = sums[4] + g;
        sums[5] = fma(h, value.lse, sums[5]);
        if constexpr (N == 1) {
            add_edge(edges[__builtin_ctz(those)], h, x, y);
        } else {
            const Float share = h * reciprocal(value.sum);
            Float spread = fma(h, value.spread, sums[6]);
            for (uint32_t e = 0, left = those; e < N; ++e, left &= left - 1) {
                const Float p = share * value.edge[e];
                spread = fnma(p, value.relative[e], spread);
                add_edge(edges[__builtin_ctz(left)], p, x, y);
            }
            sums[6] = spread;
        }
    }
}

template <bool DEPTH, bool EXTRAS>
__attribute__((noinline)) void sharp_layer(const Walk& walk, const Item& item, const ConvexItem& convex, int32_t index, uint32_t mask, Float* sums,
                                           EdgeSums* edges) {
    for (; mask; mask &= mask - 1) {
        const int b = __builtin_ctz(mask);
        const uint32_t those = convex.edges[b];
        for_count(__builtin_popcount(those), [&](auto count) {
            sharp_block<DEPTH, EXTRAS, count.value>(walk, item, convex, those, index, b, sums, edges);
        });
    }
}

// out [32]: the sums, with coordinates relative to the tile's first pixel.
template <bool DEPTH, bool EXTRAS>
void convex_layer(const Walk& walk, const Item& item, ConvexItem& convex, int points, int32_t index, uint32_t mask, float* out) {
    Float sums[32];
    EdgeSums edges[kMaxPoints];
    alignas(64) float offset[16 * kMaxPoints];
    clear<kConvexEdges>(sums);
    convex_blocks(convex, points, mask, offset);
    const uint32_t border = mask & ~uint32_t(convex.inside);
    const bool gentle = convex.gentle && border;
    if (!gentle)
        for (int e = 0; e < convex.n; ++e) edges[e] = {zero(), zero(), zero()};
    if (mask != border) inside_layer<DEPTH, EXTRAS>(walk, item, index, mask & convex.inside, convex.opacity, sums);
    if (gentle)
        for_count(points, [&](auto count) { gentle_layer<DEPTH, EXTRAS, count.value>(walk, item, convex, offset, index, border, sums, edges); });
    else if (border)
        sharp_layer<DEPTH, EXTRAS>(walk, item, convex, index, border, sums, edges);
    const Float X = load(kLaneX), Y = load(kLaneY);
    for (int e = 0; e < convex.n; ++e) {
        Float* to = sums + kConvexEdges + 3 * e;
        to[0] = fma(X, edges[e].p, edges[e].x), to[1] = fma(Y, edges[e].p, edges[e].y), to[2] = edges[e].p;
    }
    const int count = kConvexEdges + 3 * convex.n;
    for (int i = count; i < (count > 16 ? 32 : 16); ++i) sums[i] = zero();
    sum_lanes<16>(sums, out);
    if (count > 16) sum_lanes<16>(sums + 16, out + 16);
}
