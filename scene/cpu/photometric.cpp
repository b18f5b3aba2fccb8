#include "photometric.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <memory>
#include <new>
#include <utility>
#include <vector>

#include "clones.h"

namespace e4dgs {
namespace {

constexpr int kRadius = 5;
constexpr float kC1 = 0.01f * 0.01f, kC2 = 0.03f * 0.03f;  // SSIM constants for values in [0,1]

const std::array<float, 2 * kRadius + 1> kWindow = [] {
    std::array<float, 2 * kRadius + 1> w{};
    double sum = 0;
    for (int i = -kRadius; i <= kRadius; ++i) sum += std::exp(-i * i / (2 * 1.5 * 1.5));
    for (int i = -kRadius; i <= kRadius; ++i) w[i + kRadius] = static_cast<float>(std::exp(-i * i / (2 * 1.5 * 1.5)) / sum);
    return w;
}();

constexpr int kChannels = 3;

// Horizontal pass over one interleaved row of `n` = 3 W floats in a buffer padded by kRadius pixels on both sides.
inline void convolve_row(const float* __restrict padded, int n, float* __restrict out) {
#pragma GCC ivdep
    for (int i = 0; i < n; ++i) {
        float sum = 0;
        for (int k = 0; k < 2 * kRadius + 1; ++k) sum += kWindow[k] * padded[i + k * kChannels];
        out[i] = sum;
    }
}

// Vertical pass for row y of map [H, n]. Rows outside the image are `zeros` [n]; the sums stay in registers.
inline void convolve_column(const float* map, const float* zeros, int height, int n, int y, float* __restrict out) {
    const float* row[2 * kRadius + 1];
    for (int k = 0; k < 2 * kRadius + 1; ++k) {
        const int at = y + k - kRadius;
        row[k] = at >= 0 && at < height ? map + static_cast<int64_t>(at) * n : zeros;
    }
#pragma GCC ivdep
    for (int i = 0; i < n; ++i) {
        float sum = 0;
        for (int k = 0; k < 2 * kRadius + 1; ++k) sum += kWindow[k] * row[k][i];
        out[i] = sum;
    }
}

E4DGS_CLONES void moments_row(const float* x, const float* y, int n, float* const out[5], float* scratch) {
    const int pad = kRadius * kChannels;
    for (int m = 0; m < 5; ++m) {
        float* p = scratch + pad;
        for (int i = 0; i < n; ++i) p[i] = m == 0 ? x[i] : m == 1 ? y[i] : m == 2 ? x[i] * x[i] : m == 3 ? y[i] * y[i] : x[i] * y[i];
        convolve_row(scratch, n, out[m]);
    }
}

// From the five windowed moments of a row: the sum of SSIM, and the derivatives of SSIM with respect to mu_x, E[xx], E[xy].
E4DGS_CLONES double ssim_row(const float* const maps[5], const float* zeros, int height, int n, int y, float* d_mu, float* d_xx, float* d_xy, float* rows) {
    float* m[5];
    for (int k = 0; k < 5; ++k) {
        m[k] = rows + static_cast<int64_t>(k) * n;
        convolve_column(maps[k], zeros, height, n, y, m[k]);
    }
    float *__restrict m0 = m[0], *__restrict m1 = m[1], *__restrict m2 = m[2], *__restrict m3 = m[3], *__restrict m4 = m[4];
#pragma GCC ivdep
    for (int i = 0; i < n; ++i) {
        const float mx = m0[i], my = m1[i];
        const float vx = m2[i] - mx * mx, vy = m3[i] - my * my, cov = m4[i] - mx * my;
        const float a = 2 * mx * my + kC1, b = 2 * cov + kC2, c = mx * mx + my * my + kC1, d = vx + vy + kC2;
        const float inv = 1.0f / (c * d), s = a * b * inv;
        const float ds_dcov = 2 * a * inv, ds_dvx = -s / d;
        m0[i] = s;
        d_xx[i] = ds_dvx;
        d_xy[i] = ds_dcov;
        d_mu[i] = 2 * my * b * inv - s * 2 * mx / c - 2 * mx * ds_dvx - my * ds_dcov;
    }
    double sum = 0;
    for (int i = 0; i < n; ++i) sum += m0[i];
    return sum;
}

E4DGS_CLONES void derivative_row(const float* const in[3], int n, float* const out[3], float* scratch) {
    const int pad = kRadius * kChannels;
    for (int m = 0; m < 3; ++m) {
        for (int i = 0; i < n; ++i) scratch[pad + i] = in[m][i];
        convolve_row(scratch, n, out[m]);
    }
}

E4DGS_CLONES double gradient_row(const float* x, const float* y, const float* const maps[3], const float* zeros, int height, int n, int row, float scale_l1,
                                 float scale_ssim, float* grad, float* rows) {
    float *mu = rows, *xx = rows + n, *xy = rows + 2 * static_cast<int64_t>(n);
    convolve_column(maps[0], zeros, height, n, row, mu);
    convolve_column(maps[1], zeros, height, n, row, xx);
    convolve_column(maps[2], zeros, height, n, row, xy);
    for (int i = 0; i < n; ++i) {
        const float difference = x[i] - y[i];
        const float sign = difference > 0 ? 1.0f : difference < 0 ? -1.0f : 0.0f;
        grad[i] = scale_l1 * sign - scale_ssim * (mu[i] + 2 * x[i] * xx[i] + y[i] * xy[i]);
    }
    double sum = 0;
    for (int i = 0; i < n; ++i) sum += std::fabs(x[i] - y[i]);
    return sum;
}

// Memory for the maps. The calling thread keeps it from call to call, because fresh pages cost more than the arithmetic.
class Planes {
public:
    explicit Planes(size_t floats) : data_(floats <= kept_.second ? kept_.first.release() : fresh(floats)), size_(std::max(floats, kept_.second)) {
        kept_.second = 0;
    }
    ~Planes() {
        kept_.first.reset(size_ <= kMostKept ? data_ : (std::free(data_), nullptr));
        kept_.second = size_ <= kMostKept ? size_ : 0;
    }
    Planes(const Planes&) = delete;
    float* data() { return data_; }

private:
    struct Free {
        void operator()(float* p) const { std::free(p); }
    };
    static constexpr size_t kMostKept = size_t(32) << 20;  // floats
    static float* fresh(size_t floats) {
        void* p = std::aligned_alloc(64, (floats * sizeof(float) + 63) / 64 * 64);
        if (!p) throw std::bad_alloc();
        return static_cast<float*>(p);
    }
    static thread_local std::pair<std::unique_ptr<float, Free>, size_t> kept_;
    float* data_;
    size_t size_;
};

thread_local std::pair<std::unique_ptr<float, Planes::Free>, size_t> Planes::kept_{nullptr, 0};

}  // namespace

Photometric photometric(const float* x, const float* y, int height, int width, float w_l1, float w_ssim, float* grad, int threads) {
    const int n = width * kChannels;
    const int64_t size = static_cast<int64_t>(height) * n;
    const double count = static_cast<double>(size);
    Planes planes(static_cast<size_t>(8 * size));
    float* plane[8];
    for (int k = 0; k < 8; ++k) plane[k] = planes.data() + k * size;
    const std::vector<float> zeros(n, 0.0f);
    std::vector<double> row_sum(height, 0.0), row_l1(height, 0.0);

#pragma omp parallel num_threads(threads)
    {
        std::vector<float> scratch(n + 2 * kRadius * kChannels, 0.0f), rows(5 * static_cast<size_t>(n));
        const auto at = [&](int k, int r) { return plane[k] + static_cast<int64_t>(r) * n; };
#pragma omp for schedule(static)
        for (int r = 0; r < height; ++r) {
            float* const out[5] = {at(0, r), at(1, r), at(2, r), at(3, r), at(4, r)};
            moments_row(x + static_cast<int64_t>(r) * n, y + static_cast<int64_t>(r) * n, n, out, scratch.data());
        }
#pragma omp for schedule(static)
        for (int r = 0; r < height; ++r) {
            const float* const maps[5] = {plane[0], plane[1], plane[2], plane[3], plane[4]};
            row_sum[r] = ssim_row(maps, zeros.data(), height, n, r, at(5, r), at(6, r), at(7, r), rows.data());
        }
        // The three derivative maps go through the same (symmetric) window; planes 0-2 are free again.
#pragma omp for schedule(static)
        for (int r = 0; r < height; ++r) {
            const float* const in[3] = {at(5, r), at(6, r), at(7, r)};
            float* const out[3] = {at(0, r), at(1, r), at(2, r)};
            derivative_row(in, n, out, scratch.data());
        }
#pragma omp for schedule(static)
        for (int r = 0; r < height; ++r) {
            const float* const maps[3] = {plane[0], plane[1], plane[2]};
            const int64_t start = static_cast<int64_t>(r) * n;
            row_l1[r] = gradient_row(x + start, y + start, maps, zeros.data(), height, n, r, static_cast<float>(w_l1 / count),
                                     static_cast<float>(w_ssim / count), grad + start, rows.data());
        }
    }
    Photometric result{0.0, 0.0};
    for (int r = 0; r < height; ++r) {
        result.ssim += row_sum[r];
        result.l1 += row_l1[r];
    }
    result.ssim /= count;
    result.l1 /= count;
    return result;
}

}  // namespace e4dgs
