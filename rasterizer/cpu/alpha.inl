// Evaluating one primitive at a vector of pixels, and which blocks of a tile it may touch. Included by blend.inl.

constexpr int kVectors = 16 / kWidth;  // a block of 4 x 4 pixels; lanes run along x, then y
constexpr int kChunk = 128;

alignas(64) constexpr float kLaneX[16] = {0, 1, 2, 3, 0, 1, 2, 3, 0, 1, 2, 3, 0, 1, 2, 3};
alignas(64) constexpr float kLaneY[16] = {0, 0, 0, 0, 1, 1, 1, 1, 2, 2, 2, 2, 3, 3, 3, 3};
// Centres of the blocks, in the tile's coordinates.
struct BlockCentres {
    alignas(64) float x[16], y[16];
    constexpr BlockCentres() : x(), y() {
        for (int b = 0; b < 16; ++b) x[b] = float(b % kSide * kBlock) + 1.5f, y[b] = float(b / kSide * kBlock) + 1.5f;
    }
};
constexpr BlockCentres kCentres;
constexpr uint32_t kAllBlocks = (1u << kBlocks) - 1;

inline Float abs(Float a) { return max(a, zero() - a); }

// A primitive in the coordinates of its tile: (0, 0) is the centre of the tile's first pixel.
struct alignas(64) Item {
    float f0, f1, f2, u, v, exponent;  // Gaussians: u = f0 X + f1 Y + u0, v = f2 Y + v0
    float color[3], z;
    int32_t convex;                    // index into the chunk's convexes, -1 for a Gaussian
    const float* extras;               // null: zeros
};

struct ConvexItem {
    float a[kMaxPoints], b[kMaxPoints], c[kMaxPoints];  // L_i = a_i X + b_i Y + c_i
    float opacity, rho, limit;
    int n;
    uint16_t edges[kMaxPoints];  // blocks in which the edge matters
    uint16_t inside;             // blocks that lie inside: M is 1 there, to rounding
    // No edge rises by more than kGentle octaves from a block's centre: 2^L_i is a product of what the pixel's place in the block
    // gives, the same in all blocks, and of what the block's centre gives, so that a pixel costs one product an edge.
    bool gentle;
    alignas(64) float growth[kMaxPoints][16];   // by pixel of a block: 2^(L_i - L_i(centre))
    alignas(64) float level[kMaxPoints][16];    // by block: 2^(L_i(centre) - top)
    alignas(64) float offset[kMaxPoints][16];   // by block: L_i(centre) - top
    alignas(64) float top[16];                  // by block: max_i L_i(centre)
};

// Records lie in the order of the input, a tile visits them in order of depth.
// Inlined by force: the compiler takes a function that only prefetches for one without effect, and drops its calls.
__attribute__((always_inline)) inline void prefetch(const TileJob& job, uint32_t id) {
    if (id < job.n_gaussians) return __builtin_prefetch(&job.gaussians[id]);
    const char* record = reinterpret_cast<const char*>(&job.convexes[id - job.n_gaussians]);
    for (int at = 0; at < int(sizeof(ConvexRecord)); at += 64) __builtin_prefetch(record + at);
}

inline float bounded(double x) { return x > 1e30 ? 1e30f : x < -1e30 ? -1e30f : float(x); }

inline void gather(const TileJob& job, uint32_t id, double ox, double oy, Item& item, ConvexItem* convexes, int& n_convexes) {
    if (id < job.n_gaussians) {
        const GaussianRecord& r = job.gaussians[id];
        const double dx = ox - r.x, dy = oy - r.y;
        item.f0 = float(r.f[0]), item.f1 = float(r.f[1]), item.f2 = float(r.f[2]);
        item.u = float(r.f[0] * dx + r.f[1] * dy), item.v = float(r.f[2] * dy);
        item.exponent = r.exponent;
        item.color[0] = r.color[0], item.color[1] = r.color[1], item.color[2] = r.color[2], item.z = r.z;
        item.convex = -1;
        item.extras = job.gaussian_extras ? job.gaussian_extras + int64_t(id) * job.extras : nullptr;
        return;
    }
    id -= job.n_gaussians;
    const ConvexRecord& r = job.convexes[id];
    ConvexItem& c = convexes[n_convexes];
    for (int i = 0; i < r.n; ++i) {
        c.a[i] = bounded(r.A[i]), c.b[i] = bounded(r.B[i]);
        c.c[i] = bounded(r.A[i] * (ox - r.x0) + r.B[i] * (oy - r.y0) + r.C[i]);
    }
    c.opacity = r.opacity, c.rho = r.rho, c.limit = r.limit, c.n = r.n;
    item.color[0] = r.color[0], item.color[1] = r.color[1], item.color[2] = r.color[2], item.z = r.z;
    item.convex = n_convexes++;
    item.extras = job.convex_extras ? job.convex_extras + int64_t(id) * job.extras : nullptr;
}

// Blocks whose pixel centres may meet the disc u^2 + v^2 <= radius^2, by three separating axes: the block's own two edges and
// the line from the disc's centre to the block's. A block is a parallelogram in the (u, v) plane.
inline uint32_t gaussian_blocks(const Item& g, float radius) {
    constexpr float h = 0.5f * (kBlock - 1);
    const float r = radius + 1e-4f;
    const float side = __builtin_sqrtf(g.f1 * g.f1 + g.f2 * g.f2);
    const Float f0 = set1(g.f0), f1 = set1(g.f1), f2 = set1(g.f2), r2 = set1(r * r), half = set1(h);
    const Float high_v = set1(r + h * g.f2), high_n = set1(r * side + h * g.f0 * g.f2);
    uint32_t mask = 0;
    for (int k = 0; k < kVectors; ++k) {
        const Float y = load(kCentres.y + k * kWidth);
        const Float u = fma(f0, load(kCentres.x + k * kWidth), fma(f1, y, set1(g.u))), v = fma(f2, y, set1(g.v));
        const Float p2 = fma(u, u, v * v);
        const Float support = fma(abs(u), f0, abs(fma(u, f1, v * f2)));
        const Float gap = max(fnma(half, support, p2), zero());
        const Mask m = (high_v >= abs(v)) & (high_n >= abs(fma(u, f2, zero() - v * f1))) & (r2 * p2 >= gap * gap);
        mask |= bits(m) << (k * kWidth);
    }
    return mask & kAllBlocks;
}

// Octaves, times the sharpness rho where that is above 1: beyond it lse = top + log2 sum would lose digits that alpha shows.
constexpr float kGentle = 24.0f;

// Also finds what of the convex matters in which block. An edge 2^-22 / max(rho, 1) below another one at every pixel does not:
// all of them together change ln E = rho ln 2 lse by less than 2e-6.
// wanted: the blocks that anybody will ask for.
inline uint32_t convex_blocks(ConvexItem& c, int points, uint32_t wanted) {
    constexpr float h = 0.5f * (kBlock - 1), kInside = 26.0f;
    const float negligible = 22.0f + (c.rho > 1.0f ? __builtin_log2f(c.rho) : 0.0f);
    uint32_t mask = 0, inside = 0, edges[kMaxPoints] = {};
    float reach[kMaxPoints], furthest = 0.0f;
    for (int i = 0; i < c.n; ++i) {
        reach[i] = h * (__builtin_fabsf(c.a[i]) + __builtin_fabsf(c.b[i]));
        furthest = furthest > reach[i] ? furthest : reach[i];
    }
    c.gentle = furthest * (c.rho > 1.0f ? c.rho : 1.0f) <= kGentle;
    Float line[kVectors][kMaxPoints], top[kVectors];
    for (int k = 0; k < kVectors; ++k) {
        const Float x = load(kCentres.x + k * kWidth), y = load(kCentres.y + k * kWidth);
        Float low_top = set1(-3e38f), high_top = low_top;
        top[k] = low_top;
        for (int i = 0; i < c.n; ++i) {
            const Float l = line[k][i] = fma(set1(c.a[i]), x, fma(set1(c.b[i]), y, set1(c.c[i])));
            top[k] = max(top[k], l);
            low_top = max(low_top, l - set1(reach[i]));
            high_top = max(high_top, l + set1(reach[i]));
        }
        mask |= bits(set1(c.limit) >= low_top) << (k * kWidth);
        // log2 sum <= top + 3 for up to 8 edges
        inside |= bits(set1(-kInside) >= set1(c.rho) * (high_top + set1(3.0f))) << (k * kWidth);
        const Float least = low_top - set1(negligible);
        for (int i = 0; !c.gentle && i < c.n; ++i) edges[i] |= bits(line[k][i] + set1(reach[i]) >= least) << (k * kWidth);
    }
    mask &= kAllBlocks;
    c.inside = uint16_t(inside);
    for (int i = 0; i < c.n; ++i) c.edges[i] = uint16_t(edges[i]);
    if (!c.gentle || !(mask & wanted & ~inside)) return mask;

    for (int k = 0; k < kVectors; ++k) {
        const Float x = load(kLaneX + k * kWidth) - set1(h), y = load(kLaneY + k * kWidth) - set1(h);
        store(c.top + k * kWidth, top[k]);
        for (int i = 0; i < c.n; ++i) {
            const Float offset = line[k][i] - top[k];
            store(c.offset[i] + k * kWidth, offset);
            store(c.level[i] + k * kWidth, exp2(offset));
            store(c.growth[i] + k * kWidth, exp2(fma(set1(c.a[i]), x, set1(c.b[i]) * y)));
        }
        // Hulls of different corners take the same way through the walk, which would else be mispredicted: edges that are none add nothing.
        for (int i = c.n; i < points; ++i)
            store(c.growth[i] + k * kWidth, zero()), store(c.level[i] + k * kWidth, zero()), store(c.offset[i] + k * kWidth, zero());
    }
    for (int i = c.n; i < points; ++i) c.a[i] = c.b[i] = 0.0f;
    return mask;
}

// Before the cap; `counted` where it is at least 1/255, garbage elsewhere.
inline Float gaussian_alpha(const Item& g, Float X, Float Y, Float& u, Float& v, Mask& counted) {
    u = fma(set1(g.f0), X, fma(set1(g.f1), Y, set1(g.u)));
    v = fma(set1(g.f2), Y, set1(g.v));
    const Float e = fnma(u, u, fnma(v, v, set1(g.exponent)));
    counted = e >= set1(float(kLog2MinAlpha));
    return exp2<false>(e);
}

// The edges of a convex that matter in one block.
struct Edges {
    int n, index[kMaxPoints];
    float a[kMaxPoints], b[kMaxPoints], c[kMaxPoints];
};

inline void select_edges(const ConvexItem& item, int block, Edges& edges) {
    int n = 0;
    for (int i = 0; i < item.n; ++i) {
        edges.index[n] = i;
        edges.a[n] = item.a[i], edges.b[n] = item.b[i], edges.c[n] = item.c[i];
        n += (item.edges[i] >> block) & 1;
    }
    edges.n = n;
}

template <int N>
struct ConvexValue {
    Float edge[N];      // 2^(L_i - top)
    Float relative[N];  // L_i - top
    Float sum, spread;  // of edge; log2 sum
    Float lse;          // log2 sum 2^L_i
    Float outside;      // 1 - M
};

// alpha before the cap, from lse.
template <int N>
inline Float convex_alpha_of(const ConvexItem& item, ConvexValue<N>& value, Mask& counted) {
    // Beyond 2^30 on either side M is 0 or 1 as far as alpha goes.
    const Float E = exp2(min(max(set1(item.rho) * value.lse, set1(-60.0f)), set1(30.0f)));
    const Float inside = reciprocal(set1(1.0f) + E);
    value.outside = E * inside;
    const Float alpha = set1(item.opacity) * inside;
    counted = alpha >= set1(kMinAlpha);
    return alpha;
}

// N: of the convex's points, as many as it can have edges. lane: of the block's 16 pixels, where the vector begins.
template <int N>
__attribute__((always_inline)) inline Float gentle_alpha(const ConvexItem& item, int block, int lane, ConvexValue<N>& value, Mask& counted) {
    constexpr float h = 0.5f * (kBlock - 1);
    const Float x = load(kLaneX + lane) - set1(h), y = load(kLaneY + lane) - set1(h);
    value.sum = zero();
    for (int i = 0; i < N; ++i) {
        value.edge[i] = set1(item.level[i][block]) * load(item.growth[i] + lane);
        value.relative[i] = fma(set1(item.a[i]), x, fma(set1(item.b[i]), y, set1(item.offset[i][block])));
        value.sum = value.sum + value.edge[i];
    }
    value.spread = log2(value.sum);
    value.lse = set1(item.top[block]) + value.spread;
    return convex_alpha_of(item, value, counted);
}

// N: the number of edges that matter in the block.
template <int N>
inline Float convex_alpha(const ConvexItem& item, const Edges& edges, Float X, Float Y, ConvexValue<N>& value, Mask& counted) {
    Float line[N], top;
    for (int k = 0; k < N; ++k) {
        line[k] = fma(set1(edges.a[k]), X, fma(set1(edges.b[k]), Y, set1(edges.c[k])));
        top = k ? max(top, line[k]) : line[k];
    }
    if constexpr (N == 1) {
        value.edge[0] = value.sum = set1(1.0f);
        value.relative[0] = value.spread = zero();
    } else {
        value.sum = zero();
        for (int k = 0; k < N; ++k) {
            value.relative[k] = line[k] - top;
            value.edge[k] = exp2(value.relative[k]);
            value.sum = value.sum + value.edge[k];
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

// f(Count<n>()): loops over edges are unrolled for each number of them.
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
