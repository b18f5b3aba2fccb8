#include "photometric_rows.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <utility>

#include "clones.h"

namespace e4dgs {
namespace {

constexpr int kChunk = 256;  // floats of a row between which results stay in the first cache
constexpr float kC1 = 0.01f * 0.01f, kC2 = 0.03f * 0.03f;  // SSIM constants for values in [0,1]

const std::array<float, kTaps> kWindow = [] {
    std::array<float, kTaps> w{};
    double sum = 0;
    for (int i = -kRadius; i <= kRadius; ++i) sum += std::exp(-i * i / (2 * 1.5 * 1.5));
    for (int i = -kRadius; i <= kRadius; ++i) w[i + kRadius] = static_cast<float>(std::exp(-i * i / (2 * 1.5 * 1.5)) / sum);
    return w;
}();

// Eight floats: a row under the horizontal window is read at every offset, and the wider a load, the more often it touches two cache lines.
typedef float Eight __attribute__((vector_size(32)));
static_assert(sizeof(Eight) == kSpare * sizeof(float));

// Horizontal pass over one interleaved row of `n` = 3 W floats in a buffer padded by kRadius pixels on both sides. The last
// vector may reach kSpare floats too far.
E4DGS_INLINE void convolve_row(const float* __restrict padded, int n, float* __restrict out) {
    for (int i = 0; i < n; i += kSpare) {
        Eight sum = {};
        for (int k = 0; k < kTaps; ++k) {
            Eight value;
            std::memcpy(&value, padded + i + k * kChannels, sizeof value);
            sum += kWindow[k] * value;
        }
        std::memcpy(out + i, &sum, sizeof sum);
    }
}

// Row J of kSpan is under tap J - o of output row o.
template <int J, int O>
E4DGS_INLINE void add_to(float (&sum)[kTogether], float value) {
    if constexpr (J >= O && J - O < kTaps) sum[O] += kWindow[J - O] * value;
}
template <int J, int... O>
E4DGS_INLINE void add_row(float (&sum)[kTogether], float value, std::integer_sequence<int, O...>) {
    (add_to<J, O>(sum, value), ...);
}
template <int... J>
E4DGS_INLINE void add_rows(float (&sum)[kTogether], const float* const* row, int i, std::integer_sequence<int, J...>) {
    (add_row<J>(sum, row[J][i], std::make_integer_sequence<int, kTogether>{}), ...);
}

// Vertical pass for kTogether rows: `row` [kSpan], floats begin .. begin + count.
E4DGS_INLINE void convolve_columns(const float* const* row, int begin, int count, float (*__restrict out)[kChunk]) {
#pragma GCC ivdep
    for (int i = 0; i < count; ++i) {
        float sum[kTogether] = {};
        add_rows(sum, row, begin + i, std::make_integer_sequence<int, kSpan>{});
        for (int o = 0; o < kTogether; ++o) out[o][i] = sum[o];
    }
}

}  // namespace

E4DGS_CLONES void moments_row(const float* __restrict x, const float* __restrict y, int n, float* const out[kMoments], float* __restrict scratch) {
    float* p = scratch + kPad;
    std::copy(x, x + n, p);
    convolve_row(scratch, n, out[0]);
    std::copy(y, y + n, p);
    convolve_row(scratch, n, out[1]);
    for (int i = 0; i < n; ++i) p[i] = x[i] * x[i] + y[i] * y[i];
    convolve_row(scratch, n, out[2]);
    for (int i = 0; i < n; ++i) p[i] = x[i] * y[i];
    convolve_row(scratch, n, out[3]);
}

E4DGS_CLONES void ssim_rows(const float* const maps[kMoments][kSpan], int n, const SsimRow out[kTogether]) {
    alignas(64) float m[kMoments][kTogether][kChunk];
    for (int begin = 0; begin < n; begin += kChunk) {
        const int count = std::min(kChunk, n - begin);
        for (int k = 0; k < kMoments; ++k) convolve_columns(maps[k], begin, count, m[k]);
        for (int o = 0; o < kTogether; ++o) {
            const float *m0 = m[0][o], *m1 = m[1][o], *m2 = m[2][o], *m3 = m[3][o];
            float *ssim = out[o].ssim + begin, *d_mu = out[o].d[0] + begin, *d_xx = out[o].d[1] + begin, *d_xy = out[o].d[2] + begin;
#pragma GCC ivdep
            for (int i = 0; i < count; ++i) {
                const float mx = m0[i], my = m1[i];
                const float squares = mx * mx + my * my, variances = m2[i] - squares, cov = m3[i] - mx * my;
                const float a = 2 * mx * my + kC1, b = 2 * cov + kC2, c = squares + kC1, d = variances + kC2;
                const float inv = 1.0f / (c * d), s = a * b * inv;
                const float ds_dcov = 2 * a * inv, ds_dvx = -s / d;
                ssim[i] = s;
                d_xx[i] = ds_dvx;
                d_xy[i] = ds_dcov;
                d_mu[i] = 2 * my * b * inv - s * 2 * mx / c - 2 * mx * ds_dvx - my * ds_dcov;
            }
        }
    }
}

E4DGS_CLONES void derivative_row(const float* const padded[kDerivatives], int n, float* const out[kDerivatives]) {
    for (int m = 0; m < kDerivatives; ++m) convolve_row(padded[m], n, out[m]);
}

E4DGS_CLONES void sum_rows(const SsimRow rows[kTogether], const float* const x[kTogether], const float* const y[kTogether], int n, double ssim[kTogether],
                           double l1[kTogether]) {
    double s[kTogether] = {}, d[kTogether] = {};
    for (int i = 0; i < n; ++i)
        for (int o = 0; o < kTogether; ++o) s[o] += rows[o].ssim[i], d[o] += std::fabs(x[o][i] - y[o][i]);
    std::copy(s, s + kTogether, ssim), std::copy(d, d + kTogether, l1);
}

E4DGS_CLONES void gradient_rows(const float* const x[kTogether], const float* const y[kTogether], const float* const maps[kDerivatives][kSpan], int n,
                                float scale_l1, float scale_ssim, float* const grad[kTogether]) {
    alignas(64) float m[kDerivatives][kTogether][kChunk];
    for (int begin = 0; begin < n; begin += kChunk) {
        const int count = std::min(kChunk, n - begin);
        for (int k = 0; k < kDerivatives; ++k) convolve_columns(maps[k], begin, count, m[k]);
        for (int o = 0; o < kTogether && grad[o]; ++o) {
            const float *mu = m[0][o], *xx = m[1][o], *xy = m[2][o], *px = x[o] + begin, *py = y[o] + begin;
            float* to = grad[o] + begin;
#pragma GCC ivdep
            for (int i = 0; i < count; ++i) {
                const float difference = px[i] - py[i];
                const float of_l1 = difference != 0 ? std::copysign(1.0f, difference) * scale_l1 : 0.0f;  // no branch on the sign: it is random
                to[i] = of_l1 - scale_ssim * (mu[i] + 2 * px[i] * xx[i] + py[i] * xy[i]);
            }
        }
    }
}

E4DGS_CLONES void recorded_row(const float* __restrict x, const float* __restrict y, const float* __restrict weight, const float gain[kChannels],
                               const float offset[kChannels], int pixels, float* __restrict out) {
    for (int p = 0; p < pixels; ++p)
        for (int c = 0; c < kChannels; ++c) {
            const int i = kChannels * p + c;
            out[i] = !weight || weight[p] != 0 ? gain[c] * x[i] + offset[c] : y[i];
        }
}

E4DGS_CLONES void weigh_row(const float* __restrict x, const float* __restrict weight, const float gain[kChannels], int pixels, float* __restrict grad,
                            double d_gain[kChannels], double d_offset[kChannels]) {
    constexpr int kLanes = 16;  // pixels that are summed side by side
    float of_gain[kLanes * kChannels] = {}, of_offset[kLanes * kChannels] = {};
    float factor[kLanes * kChannels];
    for (int i = 0; i < kLanes * kChannels; ++i) factor[i] = gain[i % kChannels];
    for (int first = 0; first < pixels; first += kLanes) {
        const int count = std::min(kLanes, pixels - first) * kChannels;
        float* const g = grad + kChannels * first;
        const float* const from = x + kChannels * first;
        if (weight)
            for (int i = 0; i < count; ++i) g[i] *= weight[first + i / kChannels];
        for (int i = 0; i < count; ++i) {
            of_gain[i] += g[i] * from[i];
            of_offset[i] += g[i];
            g[i] *= factor[i];
        }
    }
    for (int i = 0; i < kLanes * kChannels; ++i) d_gain[i % kChannels] += of_gain[i], d_offset[i % kChannels] += of_offset[i];
}

}  // namespace e4dgs
