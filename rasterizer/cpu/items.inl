// The data that a tile needs of each primitive: its record in the tile's coordinates. Included by blend.inl.

constexpr int kVectors = 16 / kWidth;  // vectors per block of 4 x 4 pixels; lanes run along x, then y
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
    const float* extras;               // null counts as zeros
};

// The lines L_i = a_i X + b_i Y + c_i of the edges, stored twice, so that two blocks can be processed at once. Lines beyond the last edge
// are constant and far below all others, so they add nothing.
struct ConvexItem {
    alignas(64) float a[16], b[16], c[16];
    float opacity, rho, limit;
    int n;
    // True if no edge rises by more than kGentle octaves from a block's centre. Then 2^L_i is the product of a factor for the pixel's
    // position in the block, which is the same in all blocks, and a factor for the block's centre, so a pixel costs one product per edge.
    bool gentle;
    uint16_t inside;             // blocks that lie inside the hull: M is 1 there, up to rounding
    uint8_t edges[16];           // for a sharp convex, by block: the edges that matter, one bit each
    alignas(64) float growth[kMaxPoints][16];  // for a gentle convex, by pixel of a block: 2^(L_i - L_i(centre))
    alignas(64) float level[16][kMaxPoints];   // by block: 2^(L_i(centre) - top)
    alignas(64) float top[16];                 // by block: max_i L_i(centre)
};

// Records are stored in input order, but a tile visits them in depth order.
// Always inlined: the compiler assumes that a function that only prefetches has no effect, and drops calls of it.
__attribute__((always_inline)) inline void prefetch(const TileJob& job, uint32_t id) {
    if (id < job.n_gaussians) return __builtin_prefetch(&job.gaussians[id]);
    const char* record = reinterpret_cast<const char*>(&job.convexes[id - job.n_gaussians]);
    for (int at = 0; at < convex_bytes(job.points); at += 64) __builtin_prefetch(record + at);
}

inline float depth_of(const TileJob& job, uint32_t id) {
    return id < job.n_gaussians ? job.gaussians[id].z : job.convexes[id - job.n_gaussians].z;
}

typedef double EightDoubles __attribute__((vector_size(64)));
typedef int64_t EightWords __attribute__((vector_size(64)));
typedef float EightFloats __attribute__((vector_size(32)));
static_assert(kMaxPoints == 8);

// Writes the values twice, as floats clamped to +-1e30, so that sums of them stay finite.
__attribute__((always_inline)) inline void twice(const EightDoubles& from, float* to) {
    constexpr EightFloats most = {1e30f, 1e30f, 1e30f, 1e30f, 1e30f, 1e30f, 1e30f, 1e30f};
    EightFloats v = __builtin_convertvector(from, EightFloats);
    v = v > most ? most : v;
    v = v < -most ? -most : v;
    __builtin_memcpy(to, &v, sizeof(v));
    __builtin_memcpy(to + kMaxPoints, &v, sizeof(v));
}

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
    EightDoubles A, B, C;
    __builtin_memcpy(&A, r.A(), sizeof(A)), __builtin_memcpy(&B, r.B(), sizeof(B)), __builtin_memcpy(&C, r.C(), sizeof(C));
    C = A * (ox - r.x0) + B * (oy - r.y0) + C;
    constexpr EightWords lane = {0, 1, 2, 3, 4, 5, 6, 7};
    const EightWords there = lane < int64_t(r.points);
    twice(there ? A : EightDoubles{}, c.a), twice(there ? B : EightDoubles{}, c.b), twice(there ? C : EightDoubles{} + kNoEdge, c.c);
    c.opacity = r.opacity, c.rho = r.rho, c.limit = r.limit, c.n = r.n;
    item.color[0] = r.color[0], item.color[1] = r.color[1], item.color[2] = r.color[2], item.z = r.z;
    item.convex = n_convexes++;
    item.extras = job.convex_extras ? job.convex_extras + int64_t(id) * job.extras : nullptr;
}

