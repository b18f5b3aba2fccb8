// Definitions that all kernels share, such as sizes and the approximations they may choose. Includes no headers of the host, so that NVRTC
// needs nothing but this folder and ../math.
#pragma once
#include "constants.h"

namespace e4dgs {

using int8 = signed char;
using uint8 = unsigned char;
using uint16 = unsigned short;
using uint32 = unsigned int;
using int64 = long long;

constexpr int kTile = 16;            // px, side of a tile
constexpr int kRegion = 8;           // px, side of a region, the part of a tile that one warp blends
constexpr int kRegions = 4;          // regions in a tile: 0 1 / 2 3
constexpr int kLanePixels = 2;       // pixels of a lane: (x, y) and (x, y + 4) of its region
constexpr int kBlendThreads = 128;   // threads that blend a tile
constexpr uint32 kAllLanes = 0xffffffffu;

#if defined(E4DGS_EMULATED)
// A result that the hardware might return: the exact one, perturbed by as much as its manual allows. The argument's bits determine the
// sign.
inline float off_by(double exact, double error, float a) { return float(exact + (__float_as_uint(a) * 2654435761u >> 31 ? error : -error)); }
#endif

// The hardware's 2^a, with a relative error of at most 2^-22.5. Denormal results become zero.
__device__ __forceinline__ float exp2_approx(float a) {
#if defined(E4DGS_EMULATED)
    const double exact = exp2(double(a));
    return exact < 1.1754943508222875e-38 ? 0.0f : off_by(exact, 1.6e-7 * exact, a);
#else
    float r;
    asm("ex2.approx.ftz.f32 %0, %1;" : "=f"(r) : "f"(a));
    return r;
#endif
}

// The hardware's log2, with an error of at most 2^-22: absolute for a between 1/2 and 2, relative elsewhere.
__device__ __forceinline__ float log2_approx(float a) {
#if defined(E4DGS_EMULATED)
    const double exact = log2(double(a));
    return off_by(exact, 2.384e-7 * (fabs(exact) > 1 ? fabs(exact) : 1.0), a);
#else
    float r;
    asm("lg2.approx.ftz.f32 %0, %1;" : "=f"(r) : "f"(a));
    return r;
#endif
}

// 1 / a with an error of at most one unit in the last place.
__device__ __forceinline__ float reciprocal(float a) {
#if defined(E4DGS_EMULATED)
    return off_by(1.0 / double(a), 0.6e-7 / fabs(double(a)), a);
#else
    float r;
    asm("rcp.approx.ftz.f32 %0, %1;" : "=f"(r) : "f"(a));
    return r;
#endif
}

__device__ __forceinline__ bool is_finite(float a) { return (__float_as_uint(a) & 0x7f800000u) != 0x7f800000u; }
__device__ __forceinline__ bool is_bounded(double a) { return fabs(a) <= 3.4028234663852886e38; }

// Returns the largest float instead of an infinity.
__device__ __forceinline__ float saturated(double a) {
    constexpr double most = 3.4028234663852886e38;
    return float(a > most ? most : a < -most ? -most : a);
}

}  // namespace e4dgs
