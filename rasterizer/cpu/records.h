// Projected primitives and their entries in the tiles: plain data, shared by all stages and by the kernels of every instruction set.
#pragma once
#include <cstdint>

#include "constants.h"

namespace e4dgs {

constexpr int kTile = 16;                  // px, side of a tile
constexpr int kBlock = 4;                  // px, side of a block
constexpr int kSide = kTile / kBlock;      // blocks along the side of a tile
constexpr int kBlocks = kSide * kSide;     // blocks in a tile, one bit each in a mask
constexpr int kPixels = kTile * kTile;     // pixels in a tile

// One projected Gaussian: a cache line. alpha = 2^(exponent - u^2 - v^2), see exponent_factor().
struct alignas(64) GaussianRecord {
    double x, y;         // mean, px
    double f[3];         // triangular factor
    float exponent;      // log2(opacity)
    float radius;        // sqrt(exponent + log2 255): radius of the support in the (u, v) plane, slightly enlarged
    float color[3], z;
};

constexpr double kNoEdge = -3e38;

// One projected convex: alpha = opacity / (1 + 2^(rho log2 sum_i 2^L_i)), L_i = A_i (px - x0) + B_i (py - y0) + C_i.
struct alignas(64) ConvexRecord {
    double x0, y0;             // the centroid's projection, px
    float opacity, rho;        // rho = kappa / tau
    float limit;               // alpha >= 1/255 is possible only where every L_i <= limit
    float color[3], z;
    uint16_t n, points;        // number of edges; number of points
    double lines[3 * kMaxPoints];  // A, B, C, [points] each, so that six points fill three cache lines; 0, 0, kNoEdge beyond the n edges
    const double* A() const { return lines; }
    const double* B() const { return lines + points; }
    const double* C() const { return lines + 2 * points; }
};
static_assert(sizeof(ConvexRecord) == 256);

// Number of bytes of a record that are in use.
inline int convex_bytes(int points) { return int(sizeof(ConvexRecord)) - int(sizeof(double)) * 3 * (kMaxPoints - points); }

// The tiles that a primitive's bounding box overlaps; x1 and y1 are exclusive.
struct TileBox {
    uint16_t x0, x1, y0, y1;
    bool wide() const { return x1 - x0 > 1 && y1 - y0 > 1; }  // only then is a closer look worthwhile
};

struct Span {
    uint16_t first, last;  // tiles of one row; last is exclusive
};

// Both kinds are numbered together: Gaussians 0..N-1, convexes N..N+M-1.
struct Entry {
    uint32_t primitive;
    uint32_t slot;  // where this (tile, primitive) pair's gradients go, in units of 4 floats
};

constexpr int kSlotShape = 4;      // offset of the shape gradients in a slot, after color 3 and z 1
constexpr int kGaussianShape = 6;  // sum g (1, u, v, uu, uv, vv), g = dL/dalpha alpha, of uncapped pixels
constexpr int kConvexEdges = 7;    // offset of the edges, after: color 3, z, sum g, sum h lse, sum h (lse - sum_i p_i L_i)
inline int convex_shape(int points) { return kConvexEdges - kSlotShape + 3 * points; }  // then (A, B, C) for each edge

}  // namespace e4dgs
