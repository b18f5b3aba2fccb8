// The alpha of a smooth convex at a vector of pixels. Included by blend.inl.

template <int N>
struct ConvexValue {
    Float edge[N];      // 2^(L_i - top)
    Float relative[N];  // L_i - top; only for sharp convexes
    Float sum, spread;  // sum of edge; log2 sum
    Float lse;          // log2 sum 2^L_i
    Float outside;      // 1 - M
};

template <int N>
__attribute__((always_inline)) inline Float sum_of(const Float* v) {
    if constexpr (N == 1) return v[0];
    else return sum_of<(N + 1) / 2>(v) + sum_of<N / 2>(v + (N + 1) / 2);
}

// alpha before the cap, from lse.
template <int N>
__attribute__((always_inline)) inline Float convex_alpha_of(const ConvexItem& item, ConvexValue<N>& value, Mask& counted) {
    // Beyond these limits, M is 0 or 1 to within alpha's precision.
    const Float E = exp2(min(max(set1(item.rho) * value.lse, set1(-60.0f)), set1(30.0f)));
    const Float inside = reciprocal(set1(1.0f) + E);
    value.outside = E * inside;
    const Float alpha = set1(item.opacity) * inside;
    counted = alpha >= set1(kMinAlpha);
    return alpha;
}

// N: number of the convex's points, which is its largest number of edges. lane: index of the vector's first pixel among the block's 16.
template <int N>
__attribute__((always_inline)) inline Float gentle_alpha(const ConvexItem& item, int block, int lane, ConvexValue<N>& value, Mask& counted) {
    for (int i = 0; i < N; ++i) value.edge[i] = set1(item.level[block][i]) * load(item.growth[i] + lane);
    value.sum = sum_of<N>(value.edge);
    value.spread = log2(value.sum);
    value.lse = set1(item.top[block]) + value.spread;
    return convex_alpha_of(item, value, counted);
}

// N: number of bits in `edges`, which marks the edges that matter in the block.
template <int N>
__attribute__((always_inline)) inline Float sharp_alpha(const ConvexItem& item, uint32_t edges, Float X, Float Y, ConvexValue<N>& value, Mask& counted) {
    Float line[N], top;
    for (int k = 0; k < N; ++k, edges &= edges - 1) {
        const int i = __builtin_ctz(edges);
        line[k] = fma(set1(item.a[i]), X, fma(set1(item.b[i]), Y, set1(item.c[i])));
        top = k ? max(top, line[k]) : line[k];
    }
    if constexpr (N == 1) {
        value.edge[0] = value.sum = set1(1.0f);
        value.relative[0] = value.spread = zero();
    } else {
        for (int k = 0; k < N; ++k) {
            value.relative[k] = line[k] - top;
            value.edge[k] = exp2(value.relative[k]);
            value.sum = k ? value.sum + value.edge[k] : value.edge[k];
        }
        value.spread = log2(value.sum);
    }
    value.lse = top + value.spread;
    return convex_alpha_of(item, value, counted);
}

template <int N>
struct Count {
    static constexpr int value = N;
};

// Calls f(Count<n>()), so that loops over edges are unrolled for each number of edges.
template <class F>
__attribute__((always_inline)) inline void for_count(int n, F&& f) {
    switch (n) {
        case 1: return f(Count<1>());
        case 2: return f(Count<2>());
        case 3: return f(Count<3>());
        case 4: return f(Count<4>());
        case 5: return f(Count<5>());
        case 6: return f(Count<6>());
        case 7: return f(Count<7>());
        default: return f(Count<8>());
    }
}

inline Mask all() { return zero() >= zero(); }

// The alphas before the cap at the pixels X, Y of block b, which convex_blocks() has been asked for.
__attribute__((always_inline)) inline void convex_alphas(const ConvexItem& convex, int points, int b, const Float* X, const Float* Y, Float* raws,
                                                         Mask* counts) {
    if (convex.inside >> b & 1) {
        for (int k = 0; k < kVectors; ++k) raws[k] = set1(convex.opacity), counts[k] = all();
    } else if (convex.gentle) {
        for_count(points, [&](auto count) {
            ConvexValue<count.value> value;
            for (int k = 0; k < kVectors; ++k) raws[k] = gentle_alpha(convex, b, k * kWidth, value, counts[k]);
        });
    } else {
        const uint32_t edges = convex.edges[b];
        for_count(__builtin_popcount(edges), [&](auto count) {
            ConvexValue<count.value> value;
            for (int k = 0; k < kVectors; ++k) raws[k] = sharp_alpha(convex, edges, X[k], Y[k], value, counts[k]);
        });
    }
}
