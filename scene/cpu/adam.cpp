#include "adam.h"

#include <algorithm>
#include <bit>
#include <cmath>

#include "clones.h"
#include "flush.h"

namespace e4dgs {
namespace {

constexpr int64_t kGrain = 16384;  // floats

inline bool any(const float* gradient, int64_t n) {
    uint32_t found = 0;  // on the bits, so that the loop is vectorised; NaN counts as a gradient
    for (int64_t i = 0; i < n; ++i) found |= std::bit_cast<uint32_t>(gradient[i]) & 0x7fffffffu;
    return found != 0;
}

inline void adam_range(float* __restrict p, const float* __restrict g, float* __restrict m, float* __restrict v, int64_t n, const AdamStep& step,
                       float rate, float inverse_root) {
    for (int64_t i = 0; i < n; ++i) {
        m[i] = step.beta1 * m[i] + (1.0f - step.beta1) * g[i];
        v[i] = step.beta2 * v[i] + (1.0f - step.beta2) * g[i] * g[i];
        p[i] -= rate * m[i] / (std::sqrt(v[i]) * inverse_root + step.epsilon);
    }
}

E4DGS_CLONES void adam_block(float* p, const float* g, float* m, float* v, int64_t begin, int64_t end, int64_t width, const AdamStep step) {
    const float rate = step.rate / step.correction1, inverse_root = 1.0f / std::sqrt(step.correction2);
    for (int64_t r = begin; r < end;) {  // consecutive rows with a gradient are updated together
        if (!any(g + r * width, width)) {
            ++r;
            continue;
        }
        int64_t last = r + 1;
        while (last < end && any(g + last * width, width)) ++last;
        const int64_t at = r * width;
        adam_range(p + at, g + at, m + at, v + at, (last - r) * width, step, rate, inverse_root);
        r = last;
    }
}

}  // namespace

void adam_rows(float* parameter, const float* gradient, float* first, float* second, int64_t rows, int64_t width, const AdamStep& step, int threads) {
    const int64_t each = std::max<int64_t>(1, kGrain / std::max<int64_t>(1, width)), blocks = (rows + each - 1) / each;
#pragma omp parallel num_threads(threads)
    {
        [[maybe_unused]] const FlushDenormals flush;
#pragma omp for schedule(static)
        for (int64_t b = 0; b < blocks; ++b) adam_block(parameter, gradient, first, second, b * each, std::min(rows, (b + 1) * each), width, step);
    }
}

}  // namespace e4dgs
