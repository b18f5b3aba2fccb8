// The data that a tile needs of its primitives: their records in the tile's own coordinates, in shared memory, and which of its regions
// each may touch. (0, 0) is the centre of the tile's first pixel. Features: POINTS, EXTRAS (channels, at most 8 per launch).
#pragma once
#include "records.cuh"

#if !defined(EXTRAS)
#define EXTRAS 0
#endif

namespace e4dgs {

// The float4s of an item (- is unused). Gaussian: u0 v0 f0 f1, f2 exponent z -, r g b -. Convex: opacity rho z -, - - - -, r g b -, a b c
// - per edge.
constexpr int kItemWords = 3 + POINTS;
// Blocks that should fit on a multiprocessor at once, which limits the registers. Without this, the compiler spills a few to fit one more
// block.
constexpr int kResident = POINTS ? (EXTRAS > 2 ? 3 : EXTRAS ? 4 : 5) : (EXTRAS > 2 ? 5 : 7);
constexpr uint32 kConvexMark = 0x80;  // set in addition to the bits of the regions

struct Primitives {
    const GaussianRecord* gaussians;
    const ConvexRecord* convexes;
    const int* ids;                                // of each slot, the primitive, whose extras these are:
    const float *gaussian_extras, *convex_extras;  // [*, channels]; null counts as zeros
    int n_gaussians, channels, first_channel;
};

__device__ inline float depth_of(const Primitives& all, int id) {
#if POINTS
    if (id >= all.n_gaussians) return all.convexes[id - all.n_gaussians].z;
#endif
    return all.gaussians[id].z;
}

// Regions whose pixel centres may intersect the disc u^2 + v^2 <= radius^2, tested with three separating axes: the region's own two edges
// and the line from the disc's centre to the region's centre. A region is a parallelogram in the (u, v) plane.
__device__ inline uint32 gaussian_regions(float f0, float f1, float f2, float u0, float v0, float radius) {
    constexpr float h = 0.5f * (kRegion - 1);
    const float r = radius + 1e-4f, side = sqrtf(f1 * f1 + f2 * f2), high_v = r + h * f2, high_n = r * side + h * f0 * f2;
    uint32 mask = 0;
#pragma unroll
    for (int b = 0; b < kRegions; ++b) {
        const float x = h + float(b % 2 * kRegion), y = h + float(b / 2 * kRegion);
        const float u = fmaf(f0, x, fmaf(f1, y, u0)), v = fmaf(f2, y, v0), p2 = fmaf(u, u, v * v);
        const float support = fmaf(fabsf(u), f0, fabsf(fmaf(u, f1, v * f2)));
        const float gap = fmaxf(fmaf(-h, support, p2), 0.0f);
        const bool meets = high_v >= fabsf(v) && high_n >= fabsf(fmaf(u, f2, -(v * f1))) && r * r * p2 >= gap * gap;
        mask |= uint32(meets) << b;
    }
    return mask;
}

__device__ inline uint32 gather_gaussian(const GaussianRecord& r, double ox, double oy, float nearest, float4* item) {
    const double dx = ox - r.x, dy = oy - r.y;
    const float f0 = float(r.f[0]), f1 = float(r.f[1]), f2 = float(r.f[2]);
    const float u = float(r.f[0] * dx + r.f[1] * dy), v = float(r.f[2] * dy);
    item[0] = make_float4(u, v, f0, f1);
    item[1] = make_float4(f2, r.exponent, r.z - nearest, 0.0f);
    item[2] = make_float4(r.color[0], r.color[1], r.color[2], 0.0f);
    return gaussian_regions(f0, f1, f2, u, v, r.radius);
}

#if POINTS
__device__ __forceinline__ float within(double a) { return float(a > 1e30 ? 1e30 : a < -1e30 ? -1e30 : a); }  // so that sums stay finite

__device__ inline uint32 gather_convex(const ConvexRecord& r, double ox, double oy, float nearest, float4* item) {
    constexpr float h = 0.5f * (kRegion - 1);
    item[0] = make_float4(r.opacity, r.rho, r.z - nearest, 0.0f);
    item[2] = make_float4(r.color[0], r.color[1], r.color[2], 0.0f);
    float top[kRegions];
#pragma unroll
    for (int b = 0; b < kRegions; ++b) top[b] = -3e38f;
#pragma unroll
    for (int i = 0; i < POINTS; ++i) {
        const double A = r.line[i][0], B = r.line[i][1], C = A * (ox - r.x0) + B * (oy - r.y0) + r.line[i][2];
        const float a = within(A), b = within(B), c = within(C), reach = h * (fabsf(a) + fabsf(b));
        item[3 + i] = make_float4(a, b, c, 0.0f);
#pragma unroll
        for (int k = 0; k < kRegions; ++k)  // a lower bound of the largest line in the region
            top[k] = fmaxf(top[k], fmaf(a, h + float(k % 2 * kRegion), fmaf(b, h + float(k / 2 * kRegion), c)) - reach);
    }
    uint32 mask = kConvexMark;
#pragma unroll
    for (int b = 0; b < kRegions; ++b) mask |= uint32(r.limit >= top[b]) << b;
    return mask;
}
#endif

// Returns the regions that the primitive of slot `id` may touch, with kConvexMark set for a convex. Writes its item and its extras [EXTRAS].
__device__ inline uint32 gather(const Primitives& all, int id, double ox, double oy, float nearest, float4* item, float* extras) {
    const bool convex = id >= all.n_gaussians;
    const int index = convex ? id - all.n_gaussians : id;
    [[maybe_unused]] const float* of = convex ? all.convex_extras : all.gaussian_extras;
    if constexpr (EXTRAS > 0) {
        const int64 row = int64(all.ids[id]) * all.channels + all.first_channel;
        for (int e = 0; e < EXTRAS; ++e) extras[e] = of ? of[row + e] : 0.0f;
    }
#if POINTS
    if (convex) return gather_convex(all.convexes[index], ox, oy, nearest, item);
#endif
    return gather_gaussian(all.gaussians[index], ox, oy, nearest, item);
}

}  // namespace e4dgs
