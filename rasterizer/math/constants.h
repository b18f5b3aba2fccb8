// The rules of blending that every backend shares, and what makes these headers usable from CUDA unchanged.
#pragma once

#if defined(__CUDACC__) || defined(__CUDACC_RTC__)
#define E4DGS_HD __host__ __device__ inline
#else
#include <math.h>
#define E4DGS_HD inline
#endif

namespace e4dgs {

constexpr float kMinAlpha = 1.0f / 255.0f;        // a layer below it is skipped at that pixel
constexpr float kMaxAlpha = 0.99f;                // alpha is capped here, without gradient
constexpr float kMinTransmittance = 0.99e-4f;     // the layer that would take a pixel below it ends the pixel, not blended
constexpr double kDilation = 0.3;                 // px^2, added to a Gaussian's 2D covariance
constexpr double kDegenerateHull = 1e-5;          // area / squared extent at and below which a hull is culled
constexpr double kFlatTurn = 1e-12;               // of the squared extent: turns within rounding make no corner
constexpr int kMaxPoints = 8;                     // points of a convex

constexpr double kLn2 = 0.6931471805599453;
constexpr double kLog2E = 1.4426950408889634;

// log2 of a number in (0, 1], for constants: not every device compiler has it as one.
E4DGS_HD constexpr double constant_log2(double a) {
    int octaves = 0;
    for (; a < 1.0; a *= 2) --octaves;
    const double s = (a - 1) / (a + 1);  // ln a = 2 atanh s, and a <= 2
    double power = s, sum = 0.0;
    for (int i = 1; i < 60; i += 2, power *= s * s) sum += power / i;
    return octaves + 2 * sum * kLog2E;
}
constexpr double kLog2MinAlpha = constant_log2(double(kMinAlpha));  // exponents below it are alphas below kMinAlpha

// What a comparison of two T gives: T may be a vector of numbers.
template <class T>
struct TruthOf {
    using type = bool;
};
template <class T>
using Truth = typename TruthOf<T>::type;

// A number of a point for each number in a T.
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
