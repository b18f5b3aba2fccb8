// Projected primitives, in the form in which the passes exchange them.
#pragma once
#include "device.cuh"

#if !defined(POINTS)
#define POINTS 0  // K, the points of each convex; 0: a program without convexes
#endif

namespace e4dgs {

constexpr double kSlack = 1e-4;  // supports are enlarged by this much (in exponents), so that rounding never cuts a visible pixel

// What a frame has, counted on the device: the Gaussians and convexes that may be visible, the pairs of a tile and a primitive, and the
// Gaussians and primitives (Gaussians first) that are kept, which are fewer if there was too little room.
enum Count { kSeenGaussians, kSeenConvexes, kPairs, kKeptGaussians, kKept, kCounts };

// One projected Gaussian: two 32-byte sectors. alpha = 2^(exponent - u^2 - v^2), see exponent_factor().
struct alignas(64) GaussianRecord {
    double x, y;     // mean, px
    double f[3];     // triangular factor
    float exponent;  // log2(opacity)
    float radius;    // sqrt(exponent + log2 255): radius of the support in the (u, v) plane, slightly enlarged
    float color[3], z;
};
static_assert(sizeof(GaussianRecord) == 64);

#if POINTS
constexpr float kNoEdge = -1e30f;

// One projected convex: alpha = opacity / (1 + 2^(rho log2 sum_i 2^L_i)), L_i = A_i (px - x0) + B_i (py - y0) + C_i.
struct alignas(16) ConvexRecord {
    double x0, y0;                  // the centroid's projection, px
    float opacity, rho;             // rho = kappa / tau
    float limit;                    // alpha >= 1/255 is possible only where every L_i <= limit
    float color[3], z;
    int n;                          // number of edges
    double line[POINTS][3];         // A, B, C; 0, 0, kNoEdge beyond the n edges
};
#else
struct ConvexRecord {};
#endif

// The tiles that a primitive's bounding box overlaps; x1 and y1 are exclusive.
struct alignas(8) TileBox {
    uint16 x0, x1, y0, y1;
};

// The layout of the sums for a primitive's gradients. Gaussians: color 3, z, sum g (1, u, v, uu, uv, vv) with g = dL/dalpha alpha over
// uncapped pixels. Convexes: color 3, z, sum g, sum h lse, sum h (lse - sum_i p_i L_i), then for each edge sum h p_i (X, Y, 1).
constexpr int kGaussianSums = 10;
constexpr int kConvexEdges = 7;
constexpr int kConvexSums = kConvexEdges + 3 * POINTS;

// The tiles that a range of pixel coordinates within the image overlaps. Returns false if the range contains no pixel centre. Tile t
// contains the centres kTile t + 0.5 ... kTile t + kTile - 0.5.
__device__ inline bool tile_box(double low_x, double high_x, double low_y, double high_y, TileBox& box) {
    const int x0 = int(ceil((low_x - (kTile - 0.5)) / kTile)), x1 = int(floor((high_x - 0.5) / kTile)) + 1;
    const int y0 = int(ceil((low_y - (kTile - 0.5)) / kTile)), y1 = int(floor((high_y - 0.5) / kTile)) + 1;
    if (x0 >= x1 || y0 >= y1) return false;
    box = {uint16(x0), uint16(x1), uint16(y0), uint16(y1)};
    return true;
}

}  // namespace e4dgs
