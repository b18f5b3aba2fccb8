#include "appearance.h"

#include <cmath>
#include <cstdint>
#include <vector>

#include "clones.h"
#include "kept_buffer.h"
#include "photometric_rows.h"

namespace e4dgs {
namespace {

// A row in front of the opposite background.
E4DGS_CLONES void opposite_row(const float* __restrict x, const float* __restrict y, const Opposite& other, int64_t first, int pixels, float* __restrict x_out,
                               float* __restrict y_out) {
    const float *alpha = other.alpha + first, *known = other.known + first;
    for (int p = 0; p < pixels; ++p)
        for (int c = 0; c < kChannels; ++c) {
            const int i = kChannels * p + c;
            x_out[i] = x[i] + (1 - alpha[p]) * other.change[c];
            y_out[i] = y[i] + (1 - known[p]) * other.change[c];
        }
    if (!other.kept) return;
    for (int p = 0; p < pixels; ++p)
        for (int c = 0; c < kChannels; ++c)
            if (!other.kept[first + p]) y_out[kChannels * p + c] = x_out[kChannels * p + c];
}

// Adds the gradient of the row in front of the opposite background to grad, and returns the row's sum of |alpha - known|. slope: of that sum.
E4DGS_CLONES double join_row(const float* __restrict of_other, const float* __restrict weight, const Opposite& other, int64_t first, int pixels, float slope,
                             float* __restrict grad, float* __restrict grad_alpha) {
    const float *alpha = other.alpha + first, *known = other.known + first;
    for (int i = 0; i < kChannels * pixels; ++i) grad[i] += of_other[i];
    double sum = 0;
    for (int p = 0; p < pixels; ++p) {
        const float* g = of_other + kChannels * p;
        const float wrong = alpha[p] - known[p], factor = weight ? weight[p] : 1.0f;
        const bool counts = factor != 0 && (!other.kept || other.kept[first + p]);
        const float sign = wrong > 0 ? 1.0f : wrong < 0 ? -1.0f : 0.0f;
        grad_alpha[p] = (counts ? slope * factor * sign : 0.0f) - g[0] * other.change[0] - g[1] * other.change[1] - g[2] * other.change[2];
        sum += counts ? std::fabs(wrong) : 0.0f;
    }
    return sum;
}

}  // namespace

Appearance appearance(const float* x, const float* y, const float* weight, const Recording* recording, const Opposite& other, int height, int width,
                      float w_l1, float w_ssim, float* grad, float* grad_alpha, int threads) {
    const int64_t n = int64_t(width) * kChannels, size = height * n;
    KeptBuffer<Opposite> buffer(3 * size);
    float *const x_other = buffer.data(), *const y_other = x_other + size, *const g_other = y_other + size;
#pragma omp parallel for num_threads(threads) schedule(static)
    for (int r = 0; r < height; ++r) opposite_row(x + r * n, y + r * n, other, int64_t(r) * width, width, x_other + r * n, y_other + r * n);
    const float shares[] = {1 - other.share, other.share};
    const Photometric found[] = {photometric(x, y, weight, recording, height, width, shares[0] * w_l1, shares[0] * w_ssim, grad, threads),
                                 photometric(x_other, y_other, weight, recording, height, width, shares[1] * w_l1, shares[1] * w_ssim, g_other, threads)};
    std::vector<double> wrong(height);
    const float slope = other.w_alpha / (float(height) * float(width));
#pragma omp parallel for num_threads(threads) schedule(static)
    for (int r = 0; r < height; ++r)
        wrong[r] = join_row(g_other + r * n, weight ? weight + int64_t(r) * width : nullptr, other, int64_t(r) * width, width, slope, grad + r * n,
                            grad_alpha + int64_t(r) * width);
    Appearance result{};
    for (int k = 0; k < 2; ++k) {
        result.loss += shares[k] * (double(w_l1) * found[k].l1 + double(w_ssim) * (1 - found[k].ssim));
        for (int c = 0; c < kChannels; ++c) result.d_gain[c] += found[k].d_gain[c], result.d_offset[c] += found[k].d_offset[c];
    }
    double sum = 0;
    for (int r = 0; r < height; ++r) sum += wrong[r];
    result.loss += double(other.w_alpha) * sum / (double(height) * width);
    return result;
}

}  // namespace e4dgs
