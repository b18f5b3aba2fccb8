#include "looks.h"

#include <algorithm>
#include <vector>

#include "clones.h"
#include "exp.h"

namespace e4dgs {
namespace {

constexpr int64_t kRows = 512;  // of a block; fixed, so that sums do not depend on the number of threads
constexpr float kGrey = 0.5f / 0.28209479177387814f;  // a colour is 0.5 + C0 dc

E4DGS_CLONES void exps(const float* __restrict x, int64_t n, float* __restrict out) {
    for (int64_t i = 0; i < n; ++i) out[i] = exp_anywhere(x[i]);
}

E4DGS_CLONES void sigmoids(const float* __restrict x, int64_t n, float* __restrict out) {
    for (int64_t i = 0; i < n; ++i) out[i] = 1.0f / (1.0f + exp_anywhere(-x[i]));
}

// How much brighter than at rest a primitive is.
E4DGS_INLINE float gain_of(const Looks& in, int64_t row) {
    float gain = 0;
    for (int64_t c = 0; c < in.courses; ++c) gain += in.shades[row * in.courses + c] * in.light[c];
    return gain;
}

void colours(const Looks& in, int64_t begin, int64_t end, float* sh) {
    const int64_t wide = 3 * in.shown;
    for (int64_t row = begin; row < end; ++row) {
        float* to = sh + row * (3 + wide);
        const float gain = in.light ? gain_of(in, row) : 0.0f, *dc = in.dc + 3 * row;
        for (int c = 0; c < 3; ++c) to[c] = in.light ? dc[c] + gain * (dc[c] + kGrey) : dc[c];
        std::copy_n(in.rest + row * 3 * in.stored, wide, to + 3);
    }
}

// light: [courses] sums of this block.
void colours_back(const Looks& in, const float* g_sh, int64_t begin, int64_t end, const LooksGrad& back, double* light) {
    const int64_t wide = 3 * in.shown, stored = 3 * in.stored;
    for (int64_t row = begin; row < end; ++row) {
        const float *g = g_sh + row * (3 + wide), *dc = in.dc + 3 * row;
        const float gain = in.light ? gain_of(in, row) : 0.0f;
        float of_gain = 0;
        for (int c = 0; c < 3; ++c) {
            back.dc[3 * row + c] = g[c] * (1 + gain);
            of_gain += g[c] * (dc[c] + kGrey);
        }
        if (back.rest) std::fill(std::copy_n(g + 3, wide, back.rest + row * stored), back.rest + (row + 1) * stored, 0.0f);
        for (int64_t c = 0; back.shades && c < in.courses; ++c) {
            back.shades[row * in.courses + c] = of_gain * in.light[c];
            light[c] += double(of_gain) * in.shades[row * in.courses + c];
        }
    }
}

E4DGS_CLONES void exps_back(const float* __restrict out, const float* __restrict g, int64_t n, float* __restrict to) {
    for (int64_t i = 0; i < n; ++i) to[i] = g[i] * out[i];
}

E4DGS_CLONES void sigmoids_back(const float* __restrict out, const float* __restrict g, int64_t n, float* __restrict to) {
    for (int64_t i = 0; i < n; ++i) to[i] = g[i] * out[i] * (1.0f - out[i]);
}

}  // namespace

void looks_forward(const Looks& in, const Drawn<float>& out, int threads) {
#pragma omp parallel for num_threads(threads) schedule(static)
    for (int64_t begin = 0; begin < in.n; begin += kRows) {
        const int64_t rows = std::min(kRows, in.n - begin);
        exps(in.logs + begin * in.width, rows * in.width, out.sizes + begin * in.width);
        if (in.others) exps(in.others + begin, rows, out.other_sizes + begin);
        sigmoids(in.logits + begin, rows, out.opacities + begin);
        colours(in, begin, begin + rows, out.sh);
    }
}

void looks_backward(const Looks& in, const Drawn<const float>& out, const Drawn<const float>& grads, const LooksGrad& back, int threads) {
    const int64_t blocks = (in.n + kRows - 1) / kRows;
    std::vector<double> light(size_t(blocks * in.courses), 0.0);
#pragma omp parallel for num_threads(threads) schedule(static)
    for (int64_t b = 0; b < blocks; ++b) {
        const int64_t begin = b * kRows, rows = std::min(kRows, in.n - begin), at = begin * in.width;
        if (grads.sizes) exps_back(out.sizes + at, grads.sizes + at, rows * in.width, back.logs + at);
        if (grads.other_sizes) exps_back(out.other_sizes + begin, grads.other_sizes + begin, rows, back.others + begin);
        if (grads.opacities) sigmoids_back(out.opacities + begin, grads.opacities + begin, rows, back.logits + begin);
        if (grads.sh) colours_back(in, grads.sh, begin, begin + rows, back, light.data() + b * in.courses);
    }
    for (int64_t c = 0; back.light && c < in.courses; ++c) {
        double sum = 0;
        for (int64_t b = 0; b < blocks; ++b) sum += light[size_t(b * in.courses + c)];
        back.light[c] = float(sum);
    }
}

}  // namespace e4dgs
