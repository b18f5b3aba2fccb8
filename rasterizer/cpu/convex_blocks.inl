// Finds which blocks of a tile a convex may touch, and which of its edges matter in each. Included by blend.inl.

// Limit in octaves for the rise of an edge, times the sharpness rho if that is above 1. Beyond it, lse = top + log2 sum would lose digits
// that are visible in alpha.
constexpr float kGentle = 24.0f;
constexpr float kHalf = 0.5f * (kBlock - 1);  // distance from a block's centre to its outer pixels

// Transposes an 8x8 bit matrix: bit c of byte r goes to bit r of byte c.
inline uint64_t transposed(uint64_t x) {
    uint64_t t = (x ^ (x >> 7)) & 0x00aa00aa00aa00aaull;
    x ^= t ^ (t << 7);
    t = (x ^ (x >> 14)) & 0x0000cccc0000ccccull;
    x ^= t ^ (t << 14);
    t = (x ^ (x >> 28)) & 0x00000000f0f0f0f0ull;
    return x ^ t ^ (t << 28);
}

// The block centres repeated for vectors over (block, edge), with eight edges per block.
struct EdgeCentres {
    alignas(64) float x[16 * kMaxPoints], y[16 * kMaxPoints];
    constexpr EdgeCentres() : x(), y() {
        for (int i = 0; i < 16 * kMaxPoints; ++i) x[i] = kCentres.x[i / kMaxPoints], y[i] = kCentres.y[i / kMaxPoints];
    }
};
constexpr EdgeCentres kEdgeCentres;
static_assert(kMaxPoints == 8);

// The values of top for the blocks covered by a vector that starts at element `at` of level.
inline Float tops(const float* top, int at) {
    const Float first = set1(top[at / 8]);
    if constexpr (kWidth <= 8) return first;
    return select(load(kEdgeCentres.x + at) >= set1(kEdgeCentres.x[at] + 0.5f), set1(top[at / 8 + 1]), first);
}

// Computes growth, and level for the blocks in `wanted`. offset [16 blocks][8]: L_i(centre) - top; may be null.
inline void prepare_gentle(ConvexItem& c, int points, uint32_t wanted, float* offset) {
    for (int i = 0; i < points; ++i)
        for (int k = 0; k < kVectors; ++k) {
            const Float x = load(kLaneX + k * kWidth) - set1(kHalf), y = load(kLaneY + k * kWidth) - set1(kHalf);
            store(c.growth[i] + k * kWidth, exp2(fma(set1(c.a[i]), x, set1(c.b[i]) * y)));
        }
    constexpr int kAtOnce = kWidth > 8 ? kWidth / 8 : 1;  // blocks
    while (wanted) {
        const int b = __builtin_ctz(wanted) & ~(kAtOnce - 1);
        wanted &= ~(((1u << kAtOnce) - 1) << b);
        for (int at = 8 * b; at < 8 * (b + kAtOnce); at += kWidth) {
            const int edge = at % 8;
            const Float line = fma(load(c.a + edge), load(kEdgeCentres.x + at), fma(load(c.b + edge), load(kEdgeCentres.y + at), load(c.c + edge)));
            // exp2 saturates here. The stored value must too: in a slot without an edge, p times it would otherwise be 2^-126 kNoEdge.
            const Float over = max(line - tops(c.top, at), set1(-126.0f));
            if (offset) store(offset + at, over);
            store(c.level[0] + at, exp2(over));
        }
    }
}

// Returns the blocks in which alpha may count. Prepares the data only for those that are also in `wanted`.
// An edge that is 2^-22 / max(rho, 1) below another one at every pixel does not matter: all such edges together change
// ln E = rho ln 2 lse by less than 2e-6.
inline uint32_t convex_blocks(ConvexItem& c, int points, uint32_t wanted, float* offset = nullptr) {
    constexpr float kInside = 26.0f;
    float reach[kMaxPoints], furthest = 0.0f;
    for (int i = 0; i < kMaxPoints; ++i) {
        reach[i] = kHalf * (__builtin_fabsf(c.a[i]) + __builtin_fabsf(c.b[i]));
        furthest = furthest > reach[i] ? furthest : reach[i];
    }
    c.gentle = furthest * (c.rho > 1.0f ? c.rho : 1.0f) <= kGentle;
    uint32_t mask = 0, inside = 0, edges[kMaxPoints] = {};
    const float negligible = c.gentle || c.rho <= 1.0f ? 22.0f : 22.0f + __builtin_log2f(c.rho);
    for (int k = 0; k < kVectors; ++k) {
        const Float x = load(kCentres.x + k * kWidth), y = load(kCentres.y + k * kWidth);
        Float line[kMaxPoints], top = set1(-3e38f), low_top = top, high_top = top;
        for (int i = 0; i < c.n; ++i) {
            const Float l = line[i] = fma(set1(c.a[i]), x, fma(set1(c.b[i]), y, set1(c.c[i])));
            top = max(top, l);
            low_top = max(low_top, l - set1(reach[i]));
            high_top = max(high_top, l + set1(reach[i]));
        }
        store(c.top + k * kWidth, top);
        mask |= bits(set1(c.limit) >= low_top) << (k * kWidth);
        // log2 sum <= top + 3 for up to 8 edges
        inside |= bits(set1(-kInside) >= set1(c.rho) * (high_top + set1(3.0f))) << (k * kWidth);
        const Float least = low_top - set1(negligible);
        for (int i = 0; !c.gentle && i < c.n; ++i) edges[i] |= bits(line[i] + set1(reach[i]) >= least) << (k * kWidth);
    }
    mask &= kAllBlocks;
    c.inside = uint16_t(inside);
    wanted &= mask & ~inside;
    if (c.gentle) {
        if (wanted) prepare_gentle(c, points, wanted, offset);
        return mask;
    }
    uint64_t half[2] = {};
    for (int i = 0; i < c.n; ++i) half[0] |= uint64_t(edges[i] & 0xff) << (8 * i), half[1] |= uint64_t(edges[i] >> 8) << (8 * i);
    for (uint64_t& bytes : half) bytes = transposed(bytes);
    __builtin_memcpy(c.edges, half, sizeof(c.edges));
    return mask;
}
