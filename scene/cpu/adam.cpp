#include "adam.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <utility>

#include "clones.h"
#include "flush.h"

namespace e4dgs {
namespace {

constexpr int64_t kGrain = 16384;  // floats

E4DGS_INLINE bool any(const float* gradient, int64_t n) {
    uint32_t found = 0;  // on the bits, so that the loop is vectorised; NaN counts as a gradient
    for (int64_t i = 0; i < n; ++i) found |= std::bit_cast<uint32_t>(gradient[i]) & 0x7fffffffu;
    return found != 0;
}

E4DGS_INLINE float updated(float p, float g, float& m, float& v, const AdamStep& step, float rate, float inverse_root) {
    m = step.beta1 * m + (1.0f - step.beta1) * g;
    v = step.beta2 * v + (1.0f - step.beta2) * g * g;
    return p - rate * m / (std::sqrt(v) * inverse_root + step.epsilon);
}

E4DGS_INLINE void adam_range(float* __restrict p, const float* __restrict g, float* __restrict m, float* __restrict v, int64_t n,
                             const AdamStep& step, float rate, float inverse_root) {
    for (int64_t i = 0; i < n; ++i) p[i] = updated(p[i], g[i], m[i], v[i], step, rate, inverse_root);
}

// Rows of W floats, too few for a loop of their own: kRows of them at once, and those without a gradient keep what they have.
template <int W>
E4DGS_INLINE void adam_narrow(float* __restrict p, const float* __restrict g, float* __restrict m, float* __restrict v, const float* __restrict pace,
                              int64_t begin, int64_t end, const AdamStep& step, float rate, float inverse_root) {
    constexpr int kRows = 64;
    float value[kRows * W], first[kRows * W], second[kRows * W], rates[kRows * W];
    uint32_t found[kRows * W];
    p += begin * W, g += begin * W, m += begin * W, v += begin * W;
    std::fill(rates, rates + kRows * W, rate);
    for (int64_t row = begin; row < end; row += kRows, p += kRows * W, g += kRows * W, m += kRows * W, v += kRows * W) {
        const int count = int(std::min<int64_t>(kRows, end - row)), n = count * W;
        for (int r = 0; r < count; ++r) {
            uint32_t bits = 0;
            for (int c = 0; c < W; ++c) bits |= std::bit_cast<uint32_t>(g[r * W + c]) & 0x7fffffffu;
            for (int c = 0; c < W; ++c) found[r * W + c] = bits;
        }
        if (pace)
            for (int r = 0; r < count; ++r)
                for (int c = 0; c < W; ++c) rates[r * W + c] = rate * pace[row + r];
        std::copy(p, p + n, value), std::copy(m, m + n, first), std::copy(v, v + n, second);
        for (int i = 0; i < n; ++i) value[i] = updated(value[i], g[i], first[i], second[i], step, rates[i], inverse_root);
        for (int i = 0; i < n; ++i) {
            p[i] = found[i] ? value[i] : p[i];
            m[i] = found[i] ? first[i] : m[i];
            v[i] = found[i] ? second[i] : v[i];
        }
    }
}

E4DGS_CLONES void adam_block(float* p, const float* g, float* m, float* v, const float* pace, int64_t begin, int64_t end, int64_t width, const AdamStep step) {
    const float rate = step.rate / step.correction1, inverse_root = 1.0f / std::sqrt(step.correction2);
    switch (width) {
        case 1: return adam_narrow<1>(p, g, m, v, pace, begin, end, step, rate, inverse_root);
        case 2: return adam_narrow<2>(p, g, m, v, pace, begin, end, step, rate, inverse_root);
        case 3: return adam_narrow<3>(p, g, m, v, pace, begin, end, step, rate, inverse_root);
        case 4: return adam_narrow<4>(p, g, m, v, pace, begin, end, step, rate, inverse_root);
    }
    constexpr int kRows = 256;
    int64_t found[kRows];
    for (int64_t r = begin; r < end;) {
        int count = 0;  // collected first: which rows have a gradient cannot be predicted
        for (const int64_t last = std::min(end, r + kRows); r < last; ++r) {
            found[count] = r;
            count += any(g + r * width, width);
        }
        for (int k = 0; k < count;) {  // consecutive rows of one rate are updated together
            const int64_t row = found[k++], at = row * width;
            int64_t size = width;
            for (; !pace && k < count && found[k] * width == at + size; ++k) size += width;
            adam_range(p + at, g + at, m + at, v + at, size, step, pace ? rate * pace[row] : rate, inverse_root);
        }
    }
}

// Rows of W floats: kRows of them are copied together, updated and copied back.
template <int W>
E4DGS_INLINE void adam_scattered(float* __restrict p, const float* __restrict g, float* __restrict m, float* __restrict v, const float* __restrict pace,
                                 const int64_t* __restrict index, int64_t begin, int64_t end, const AdamStep& step, float rate, float inverse_root) {
    constexpr int kRows = 64;
    float value[kRows * W], first[kRows * W], second[kRows * W];
    for (int64_t row = begin; row < end; row += kRows) {
        const int64_t n = std::min<int64_t>(kRows, end - row);
        for (int64_t r = 0; r < n; ++r)
            for (int c = 0; c < W; ++c) {
                const int64_t at = index[row + r] * W + c;
                value[r * W + c] = p[at], first[r * W + c] = m[at], second[r * W + c] = v[at];
            }
        adam_narrow<W>(value, g + row * W, first, second, pace ? pace + row : nullptr, 0, n, step, rate, inverse_root);
        for (int64_t r = 0; r < n; ++r)
            for (int c = 0; c < W; ++c) {
                const int64_t at = index[row + r] * W + c;
                p[at] = value[r * W + c], m[at] = first[r * W + c], v[at] = second[r * W + c];
            }
    }
}

E4DGS_CLONES void adam_chosen_block(float* p, const float* g, float* m, float* v, const float* pace, const int64_t* index, int64_t begin, int64_t end,
                                    int64_t width, const AdamStep step) {
    const float rate = step.rate / step.correction1, inverse_root = 1.0f / std::sqrt(step.correction2);
    switch (width) {
        case 1: return adam_scattered<1>(p, g, m, v, pace, index, begin, end, step, rate, inverse_root);
        case 2: return adam_scattered<2>(p, g, m, v, pace, index, begin, end, step, rate, inverse_root);
        case 3: return adam_scattered<3>(p, g, m, v, pace, index, begin, end, step, rate, inverse_root);
        case 4: return adam_scattered<4>(p, g, m, v, pace, index, begin, end, step, rate, inverse_root);
    }
    for (int64_t r = begin; r < end; ++r) {
        const int64_t at = index[r] * width;
        if (any(g + r * width, width)) adam_range(p + at, g + r * width, m + at, v + at, width, step, pace ? rate * pace[r] : rate, inverse_root);
    }
}

}  // namespace

void adam(const std::vector<AdamRows>& all, int threads) {
    std::vector<std::pair<const AdamRows*, int64_t>> blocks;  // and the first row of each
    const auto each = [](const AdamRows& of) { return std::max<int64_t>(1, kGrain / std::max<int64_t>(1, of.width)); };
    for (const AdamRows& of : all)
        for (int64_t row = 0; row < of.rows; row += each(of)) blocks.emplace_back(&of, row);
#pragma omp parallel num_threads(threads)
    {
        [[maybe_unused]] const FlushDenormals flush;
#pragma omp for schedule(static)
        for (size_t k = 0; k < blocks.size(); ++k) {
            const auto [of, begin] = blocks[k];
            const int64_t end = std::min(of->rows, begin + each(*of));
            if (of->index)
                adam_chosen_block(of->parameter, of->gradient, of->first, of->second, of->pace, of->index, begin, end, of->width, of->step);
            else
                adam_block(of->parameter, of->gradient, of->first, of->second, of->pace, begin, end, of->width, of->step);
        }
    }
}

}  // namespace e4dgs
