#include "planes.h"

#include <algorithm>
#include <vector>

#include "clones.h"

namespace e4dgs {
namespace {

constexpr int kMaxChannels = 64;
constexpr int kAxisA[3] = {0, 0, 1};  // xy, xz, yz
constexpr int kAxisB[3] = {1, 2, 2};

struct Tap {
    int64_t index;
    float weight;
};

// u in [0,1] -> two neighbouring samples of a line of `count` samples whose ends are at 0 and 1.
inline void line_taps(float u, int count, int64_t& low, int64_t& high, float& fraction) {
    // In this order NaN becomes 0: its index must not lie outside.
    const float x = std::min(std::max(0.0f, u), 1.0f) * static_cast<float>(count - 1);
    low = std::min<int64_t>(static_cast<int64_t>(x), std::max(count - 2, 0));
    high = std::min<int64_t>(low + 1, count - 1);
    fraction = x - static_cast<float>(low);
}

struct PointTaps {
    int64_t low[3], high[3];
    float fraction[3];
};

inline PointTaps point_taps(const float* u, int resolution) {
    PointTaps taps;
    for (int axis = 0; axis < 3; ++axis) line_taps(u[axis], resolution, taps.low[axis], taps.high[axis], taps.fraction[axis]);
    return taps;
}

inline void bilinear_taps(const PointTaps& p, int plane, int resolution, Tap out[4]) {
    const int a = kAxisA[plane], b = kAxisB[plane];
    const float fa = p.fraction[a], fb = p.fraction[b];
    out[0] = {p.low[b] * resolution + p.low[a], (1 - fa) * (1 - fb)};
    out[1] = {p.low[b] * resolution + p.high[a], fa * (1 - fb)};
    out[2] = {p.high[b] * resolution + p.low[a], (1 - fa) * fb};
    out[3] = {p.high[b] * resolution + p.high[a], fa * fb};
}

// value [6][C] of one point: three bilinear, three linear look-ups.
inline void look_up(const PlaneLevel& level, const float* lines, const PointTaps& p, float value[6][kMaxChannels]) {
    const int c_count = level.channels, r = level.resolution;
    for (int plane = 0; plane < 3; ++plane) {
        Tap taps[4];
        bilinear_taps(p, plane, r, taps);
        const float* base = level.space + static_cast<int64_t>(plane) * r * r * c_count;
        const float *s0 = base + taps[0].index * c_count, *s1 = base + taps[1].index * c_count;
        const float *s2 = base + taps[2].index * c_count, *s3 = base + taps[3].index * c_count;
        const float w0 = taps[0].weight, w1 = taps[1].weight, w2 = taps[2].weight, w3 = taps[3].weight;
        for (int c = 0; c < c_count; ++c) value[plane][c] = w0 * s0[c] + w1 * s1[c] + w2 * s2[c] + w3 * s3[c];
        const float* line = lines + static_cast<int64_t>(plane) * r * c_count;
        const float *l0 = line + p.low[plane] * c_count, *l1 = line + p.high[plane] * c_count;
        const float f = p.fraction[plane];
        for (int c = 0; c < c_count; ++c) value[3 + plane][c] = (1 - f) * l0[c] + f * l1[c];
    }
}

E4DGS_CLONES void forward_range(const PlaneLevel& level, const float* lines, const float* u, int64_t begin, int64_t end, float* out,
                                int64_t stride, int64_t offset) {
    float value[6][kMaxChannels];
    for (int64_t i = begin; i < end; ++i) {
        look_up(level, lines, point_taps(u + 3 * i, level.resolution), value);
        float* row = out + i * stride + offset;
        for (int c = 0; c < level.channels; ++c)
            row[c] = ((value[0][c] * value[1][c]) * value[2][c]) * ((value[3][c] * value[4][c]) * value[5][c]);
    }
}

// dvalue [n][6][C]: the product rule from the left and from the right, so that no division meets a zero.
E4DGS_CLONES void product_backward_range(const PlaneLevel& level, const float* lines, const float* u, int64_t begin, int64_t end,
                                         const float* grad, int64_t stride, int64_t offset, float* dvalue) {
    const int c_count = level.channels;
    float value[6][kMaxChannels], left[kMaxChannels], right[6][kMaxChannels];
    for (int64_t i = begin; i < end; ++i) {
        look_up(level, lines, point_taps(u + 3 * i, level.resolution), value);
        const float* g = grad + i * stride + offset;
        float* d = dvalue + i * 6 * c_count;
        for (int c = 0; c < c_count; ++c) right[5][c] = 1.0f;
        for (int k = 4; k >= 0; --k)
            for (int c = 0; c < c_count; ++c) right[k][c] = right[k + 1][c] * value[k + 1][c];
        for (int c = 0; c < c_count; ++c) left[c] = g[c];
        for (int k = 0; k < 6; ++k)
            for (int c = 0; c < c_count; ++c) {
                d[k * c_count + c] = left[c] * right[k][c];
                left[c] *= value[k][c];
            }
    }
}

E4DGS_CLONES void scatter_space(const PlaneLevel& level, int plane, const float* u, int64_t n, const float* dvalue, float* grad_space) {
    const int c_count = level.channels, r = level.resolution;
    float* base = grad_space + static_cast<int64_t>(plane) * r * r * c_count;
    for (int64_t i = 0; i < n; ++i) {
        Tap taps[4];
        bilinear_taps(point_taps(u + 3 * i, r), plane, r, taps);
        const float* d = dvalue + (i * 6 + plane) * c_count;
        for (const Tap& tap : taps) {
            float* row = base + tap.index * c_count;
            for (int c = 0; c < c_count; ++c) row[c] += tap.weight * d[c];
        }
    }
}

E4DGS_CLONES void scatter_line(const PlaneLevel& level, int axis, const float* u, int64_t n, const float* dvalue, float* grad_line) {
    const int c_count = level.channels;
    for (int64_t i = 0; i < n; ++i) {
        int64_t low, high;
        float f;
        line_taps(u[3 * i + axis], level.resolution, low, high, f);
        const float* d = dvalue + (i * 6 + 3 + axis) * c_count;
        float *l0 = grad_line + low * c_count, *l1 = grad_line + high * c_count;
        for (int c = 0; c < c_count; ++c) l0[c] += (1 - f) * d[c];
        for (int c = 0; c < c_count; ++c) l1[c] += f * d[c];
    }
}

// The time planes are the same for every point of one image: interpolate them once to three lines [3,R,C].
std::vector<float> collapse_time(const PlaneLevel& level, float t) {
    int64_t low, high;
    float f;
    line_taps(t, level.times, low, high, f);
    const int64_t row = static_cast<int64_t>(level.resolution) * level.channels;
    std::vector<float> lines(3 * row);
    for (int axis = 0; axis < 3; ++axis) {
        const float* plane = level.time + axis * level.times * row;
        for (int64_t k = 0; k < row; ++k) lines[axis * row + k] = (1 - f) * plane[low * row + k] + f * plane[high * row + k];
    }
    return lines;
}

constexpr int64_t kBlock = 512;

}  // namespace

void planes_forward(const PlaneLevel& level, const float* u, int64_t n, float t, float* out, int64_t stride, int64_t offset, int threads) {
    const std::vector<float> lines = collapse_time(level, t);
    const int64_t blocks = (n + kBlock - 1) / kBlock;
#pragma omp parallel for schedule(static) num_threads(threads)
    for (int64_t b = 0; b < blocks; ++b)
        forward_range(level, lines.data(), u, b * kBlock, std::min(n, (b + 1) * kBlock), out, stride, offset);
}

void planes_backward(const PlaneLevel& level, const float* u, int64_t n, float t, const float* grad, int64_t stride, int64_t offset,
                     float* grad_space, float* grad_time, int threads) {
    const std::vector<float> lines = collapse_time(level, t);
    const int64_t row = static_cast<int64_t>(level.resolution) * level.channels;
    std::vector<float> dvalue(static_cast<size_t>(n) * 6 * level.channels);
    const int64_t blocks = (n + kBlock - 1) / kBlock;
#pragma omp parallel for schedule(static) num_threads(threads)
    for (int64_t b = 0; b < blocks; ++b)
        product_backward_range(level, lines.data(), u, b * kBlock, std::min(n, (b + 1) * kBlock), grad, stride, offset, dvalue.data());

    std::vector<float> grad_lines(3 * row, 0.0f);
#pragma omp parallel for schedule(dynamic, 1) num_threads(threads)
    for (int k = 0; k < 6; ++k) {
        if (k < 3)
            scatter_space(level, k, u, n, dvalue.data(), grad_space);
        else
            scatter_line(level, k - 3, u, n, dvalue.data(), grad_lines.data() + (k - 3) * row);
    }
    int64_t low, high;
    float f;
    line_taps(t, level.times, low, high, f);
    for (int axis = 0; axis < 3; ++axis) {
        float* plane = grad_time + axis * level.times * row;
        for (int64_t k = 0; k < row; ++k) {
            plane[low * row + k] += (1 - f) * grad_lines[axis * row + k];
            plane[high * row + k] += f * grad_lines[axis * row + k];
        }
    }
}

}  // namespace e4dgs
