#include "correlate.h"

#include <cmath>
#include <cstring>

#include "clones.h"

namespace e4dgs {
namespace {

constexpr int kLanes = 16;
typedef float Lanes __attribute__((vector_size(kLanes * sizeof(float)), aligned(4)));
constexpr int kMost = 2 * kMaxRadius + 2;

// One place of one level. Products at the window's integer places first; each output blends four of them.
E4DGS_CLONES void window(const float* a, const float* features, int height, int width, int channels, float x, float y, int radius, float* out) {
    const int side = 2 * radius + 1, grid = side + 1;
    float products[kMost * kMost] = {};
    // Beyond these no place of the window is inside, and an int would not hold every float.
    if (!(x > float(-grid) && x < float(width + grid) && y > float(-grid) && y < float(height + grid))) {
        std::memset(out, 0, sizeof(float) * size_t(side) * size_t(side));
        return;
    }
    const int x0 = int(std::floor(x)) - radius, y0 = int(std::floor(y)) - radius;
    const float fx = x - std::floor(x), fy = y - std::floor(y);
    const int left = x0 < 0 ? -x0 : 0, right = x0 + grid > width ? width - x0 : grid;
    for (int j = 0; j < grid; ++j) {
        if (y0 + j < 0 || y0 + j >= height) continue;
        const float* row = features + (int64_t(y0 + j) * width + x0) * channels;
        for (int i = left; i < right; ++i) {
            const float* b = row + int64_t(i) * channels;
            Lanes sums[2] = {};
            int c = 0;
            for (; c + 2 * kLanes <= channels; c += 2 * kLanes)
                for (int k = 0; k < 2; ++k) {
                    Lanes u, v;
                    std::memcpy(&u, a + c + k * kLanes, sizeof(u)), std::memcpy(&v, b + c + k * kLanes, sizeof(v));
                    sums[k] += u * v;
                }
            const Lanes both = sums[0] + sums[1];
            float sum = 0.0f;
            for (int l = 0; l < kLanes; ++l) sum += both[l];
            for (; c < channels; ++c) sum += a[c] * b[c];
            products[j * kMost + i] = sum;
        }
    }
    for (int i = 0; i < side; ++i)
        for (int j = 0; j < side; ++j) {
            const float* p = products + j * kMost + i;
            const float upper = p[0] + fx * (p[1] - p[0]), lower = p[kMost] + fx * (p[kMost + 1] - p[kMost]);
            out[i * side + j] = upper + fy * (lower - upper);
        }
}

}  // namespace

void correlate(const float* first, const CorrelationLevel* levels, int n_levels, const float* at, int64_t n, int channels, int radius, float* out,
               int threads) {
    const int64_t size = int64_t(2 * radius + 1) * (2 * radius + 1);
#pragma omp parallel for schedule(static) num_threads(threads)
    for (int64_t i = 0; i < n; ++i)
        for (int l = 0; l < n_levels; ++l) {
            const float scale = std::ldexp(1.0f, -l);
            window(first + i * channels, levels[l].features, levels[l].height, levels[l].width, channels, at[2 * i] * scale, at[2 * i + 1] * scale, radius,
                   out + (i * n_levels + l) * size);
        }
}

}  // namespace e4dgs
