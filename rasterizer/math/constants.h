// The blending constants that all backends share, and the helpers that let CUDA use these headers unchanged.
#pragma once

#if defined(__CUDACC__) || defined(__CUDACC_RTC__)
#define E4DGS_HD __host__ __device__ inline
#else
#include <math.h>
#define E4DGS_HD inline
#endif

namespace e4dgs {

constexpr float kMinAlpha = 1.0f / 255.0f;        // a layer with a smaller alpha is skipped at that pixel
constexpr float kMaxAlpha = 0.99f;                // alpha is capped at this value; a capped alpha has no gradient
constexpr float kMinTransmittance = 0.99e-4f;     // a layer that would take a pixel's transmittance below this stops it and is not blended
constexpr double kDilation = 0.3;                 // px^2, added to a Gaussian's 2D covariance
constexpr double kPixelVariance = 0.1;            // px^2, added instead in the antialiased mode: that of a pixel's box is 1/12
constexpr double kDegenerateHull = 1e-5;          // a hull is culled if area / squared extent is not above this
constexpr double kFlatTurn = 1e-12;               // relative to the squared extent: smaller turns may be rounding and make no corner
constexpr int kMaxPoints = 8;                     // largest number of points of a convex

constexpr double kLn2 = 0.6931471805599453;
constexpr double kLog2E = 1.4426950408889634;

// log2 of a number in (0, 1] at compile time, because not every device compiler can evaluate log2 in a constant expression.
E4DGS_HD constexpr double constant_log2(double a) {
    int octaves = 0;
    for (; a < 1.0; a *= 2) --octaves;
    const double s = (a - 1) / (a + 1);  // ln a = 2 atanh s, and a <= 2
    double power = s, sum = 0.0;
    for (int i = 1; i < 60; i += 2, power *= s * s) sum += power / i;
    return octaves + 2 * sum * kLog2E;
}
constexpr double kLog2MinAlpha = constant_log2(double(kMinAlpha));  // exponents below this give alphas below kMinAlpha

// The result type of comparing two T, where T may be a vector of numbers.
template <class T>
struct TruthOf {
    using type = bool;
};
template <class T>
using Truth = typename TruthOf<T>::type;

// A point index for each number in a T.
template <class T>
struct IndexOf {
    using type = int;
};
template <class T>
using Index = typename IndexOf<T>::type;

template <class T>
E4DGS_HD T pick(const T* from, int at) {
    return from[at];
}
template <class T>
E4DGS_HD void add_at(T* to, int at, T value) {
    to[at] += value;
}

template <class T>
E4DGS_HD T choose(bool condition, T a, T b) {
    return condition ? a : b;
}
E4DGS_HD bool none(bool condition) { return !condition; }

template <class T>
E4DGS_HD T larger(T a, T b) {
    return a > b ? a : b;
}

template <class T>
E4DGS_HD T smaller(T a, T b) {
    return a < b ? a : b;
}

}  // namespace e4dgs
