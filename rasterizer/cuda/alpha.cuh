// A primitive's alpha at the two pixels of a lane, (X, Y) and (X, Y + 4) in the tile's coordinates, before the cap. Forward and backward
// both include this file, so that they agree on which pixels count. Features: POINTS.
#pragma once
#include "tile_items.cuh"

namespace e4dgs {

constexpr float kLaneStep = 4.0f;  // px, distance between the two pixels of a lane

struct GaussianAlpha {
    float u, v, alpha;
    bool counted;  // whether alpha is at least 1/255; otherwise alpha is meaningless

    __device__ __forceinline__ void at(const float4& a, const float4& b, float X, float Y) {
        u = fmaf(a.z, X, fmaf(a.w, Y, a.x));
        v = fmaf(b.x, Y, a.y);
        const float e = fmaf(-u, u, fmaf(-v, v, b.y));
        counted = e >= float(kLog2MinAlpha);
        alpha = exp2_approx(e);
    }
};

#if POINTS
struct ConvexAlpha {
    float edge[POINTS];     // 2^(L_i - top)
    float over[POINTS];     // L_i - top
    float sum, spread;      // sum of edge; log2 sum
    float lse;              // log2 sum_i 2^L_i
    float outside;          // 1 - M
    float alpha;
    bool counted;

    // lines: a, b, c and an unused value for each edge.
    __device__ __forceinline__ void at(const float4* lines, float opacity, float rho, float X, float Y) {
        float top = -3e38f;
#pragma unroll
        for (int i = 0; i < POINTS; ++i) {
            over[i] = fmaf(lines[i].x, X, fmaf(lines[i].y, Y, lines[i].z));
            top = fmaxf(top, over[i]);
        }
        sum = 0.0f;
#pragma unroll
        for (int i = 0; i < POINTS; ++i) {
            over[i] -= top;
            edge[i] = exp2_approx(over[i]);
            sum += edge[i];
        }
        spread = log2_approx(sum);
        lse = top + spread;
        // Beyond these limits, M is 0 or 1 to within alpha's precision.
        const float E = exp2_approx(fminf(fmaxf(rho * lse, -60.0f), 30.0f)), inside = reciprocal(1.0f + E);
        outside = E * inside;
        alpha = opacity * inside;
        counted = alpha >= kMinAlpha;
    }
};
#endif

}  // namespace e4dgs
