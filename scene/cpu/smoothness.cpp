#include "smoothness.h"

#include <algorithm>
#include <vector>

#include "clones.h"

namespace e4dgs {
namespace {

// With d = b - a: adds the gradient of scale d^2 / 2 with respect to a and b; returns the sum of d^2, with partial sums of 64 in float.
E4DGS_CLONES double first_difference(const float* __restrict a, const float* __restrict b, int64_t n, float scale, float* __restrict grad_a,
                                     float* __restrict grad_b) {
    float sum = 0.0f;
#pragma GCC ivdep
    for (int64_t i = 0; i < n; ++i) grad_a[i] -= scale * (b[i] - a[i]);
#pragma GCC ivdep
    for (int64_t i = 0; i < n; ++i) grad_b[i] += scale * (b[i] - a[i]);
    double total = 0.0;
    for (int64_t at = 0; at < n; at += 64) {
        sum = 0.0f;
        for (int64_t i = at; i < std::min(n, at + 64); ++i) sum += (b[i] - a[i]) * (b[i] - a[i]);
        total += double(sum);
    }
    return total;
}

E4DGS_CLONES double second_difference(const float* a, const float* b, const float* c, int64_t n, float scale, float* __restrict grad_a,
                                      float* __restrict grad_b, float* __restrict grad_c) {
    double total = 0.0;
    for (int64_t at = 0; at < n; at += 64) {
        float sum = 0.0f;
#pragma GCC ivdep
        for (int64_t i = at; i < std::min(n, at + 64); ++i) {
            const float d = c[i] - 2.0f * b[i] + a[i];
            sum += d * d;
            grad_a[i] += scale * d, grad_b[i] -= 2.0f * scale * d, grad_c[i] += scale * d;
        }
        total += double(sum);
    }
    return total;
}

// One plane of a stack: its part of the stack's mean.
double plane(const PlaneStack& s, int index) {
    const int64_t row = s.columns * s.channels, size = s.rows * row;
    const float* values = s.values + index * size;
    float* grad = s.grad + index * size;
    std::fill_n(grad, size, 0.0f);
    double total = 0.0;
    if (s.columns > 1) {
        const double count = 3.0 * double(s.rows * (row - s.channels));
        double sum = 0.0;
        for (int64_t r = 0; r < s.rows; ++r) {
            const float* at = values + r * row;
            sum += first_difference(at, at + s.channels, row - s.channels, float(2.0 / count), grad + r * row, grad + r * row + s.channels);
        }
        total += sum / count;
    }
    const int64_t differences = s.rows - (s.second ? 2 : 1);
    if (differences > 0) {
        const double count = 3.0 * double(differences * row);
        const float scale = float(2.0 / count);
        double sum = 0.0;
        for (int64_t r = 0; r < differences; ++r) {
            const float* at = values + r * row;
            float* to = grad + r * row;
            sum += s.second ? second_difference(at, at + row, at + 2 * row, row, scale, to, to + row, to + 2 * row)
                            : first_difference(at, at + row, row, scale, to, to + row);
        }
        total += sum / count;
    }
    return total;
}

}  // namespace

double smoothness(const PlaneStack* stacks, int count, int threads) {
    std::vector<double> parts(size_t(count) * 3);
#pragma omp parallel for schedule(dynamic, 1) num_threads(threads)
    for (int job = 0; job < 3 * count; ++job) parts[size_t(job)] = plane(stacks[job / 3], job % 3);
    double total = 0.0;
    for (double part : parts) total += part;
    return total;
}

}  // namespace e4dgs
