#include "field_run.h"

#include <algorithm>
#include <cstdlib>
#include <cstring>
#include <memory>
#include <new>

#include "field.h"

namespace e4dgs {
namespace {

struct Free {
    void operator()(void* p) const { std::free(p); }
};

template <class T>
using Array = std::unique_ptr<T[], Free>;

template <class T>
Array<T> array(int64_t n) {
    void* p = std::aligned_alloc(64, (size_t(n) * sizeof(T) + 127) / 64 * 64);
    if (!p) throw std::bad_alloc();
    return Array<T>(static_cast<T*>(p));
}

void time_taps(float t, int count, int64_t& low, int64_t& high, float& fraction) {
    const float x = std::min(t > 0.0f ? t : 0.0f, 1.0f) * float(count - 1);  // NaN counts as 0
    low = std::min<int64_t>(int64_t(x), std::max(count - 2, 0));
    high = std::min<int64_t>(low + 1, count - 1);
    fraction = x - float(low);
}

// Data that lives for one call: the lines at its time, and the padded and transposed weights.
class Prepared {
public:
    Field field{};

    explicit Prepared(const FieldInput& in) {
        field.levels = int(in.levels.size()), field.channels = in.channels;
        field.width = in.mlp.width, field.outputs = in.mlp.outputs;
        for (int axis = 0; axis < 3; ++axis) field.low[axis] = in.low[axis], field.inverse_size[axis] = 1.0f / (in.high[axis] - in.low[axis]);
        for (int l = 0; l < field.levels; ++l) field.level[l] = {in.levels[l].space, lines_of(in.levels[l], in.channels, in.t), in.levels[l].resolution};
        if (!field.outputs) return;
        const int f = field.features(), w = field.width, o = field.outputs, fp = field.features_padded(), wp = field.width_padded(),
                  op = field.outputs_padded();
        field.w1 = pad(in.mlp.w1, w, f, wp, fp, false), field.w1_t = pad(in.mlp.w1, w, f, fp, wp, true), field.b1 = pad(in.mlp.b1, 1, w, 1, wp, false);
        field.w2 = pad(in.mlp.w2, w, w, wp, wp, false), field.w2_t = pad(in.mlp.w2, w, w, wp, wp, true), field.b2 = pad(in.mlp.b2, 1, w, 1, wp, false);
        field.w3 = pad(in.mlp.w3, o, w, op, wp, false), field.w3_t = pad(in.mlp.w3, o, w, wp, op, true), field.b3 = pad(in.mlp.b3, 1, o, 1, op, false);
    }

private:
    const float* pad(const float* from, int rows, int columns, int to_rows, int to_columns, bool turn) {
        float* to = fresh(int64_t(to_rows) * to_columns);
        std::fill_n(to, int64_t(to_rows) * to_columns, 0.0f);
        for (int r = 0; r < rows; ++r)
            for (int c = 0; c < columns; ++c) to[turn ? int64_t(c) * to_columns + r : int64_t(r) * to_columns + c] = from[int64_t(r) * columns + c];
        return to;
    }

    // All points of an image share one time, so the time planes are interpolated once.
    const float* lines_of(const PlaneLevel& level, int channels, float t) {
        int64_t low, high;
        float f;
        time_taps(t, level.times, low, high, f);
        const int64_t row = int64_t(level.resolution) * channels;
        float* lines = fresh(3 * row);
        for (int axis = 0; axis < 3; ++axis) {
            const float* plane = level.time + axis * level.times * row;
            for (int64_t k = 0; k < row; ++k) lines[axis * row + k] = (1 - f) * plane[low * row + k] + f * plane[high * row + k];
        }
        return lines;
    }

    float* fresh(int64_t n) {
        owned_.push_back(array<float>(n));
        return owned_.back().get();
    }

    std::vector<Array<float>> owned_;
};

void write_unpadded(const double* from, int rows, int columns, int padded_columns, float* to) {
    for (int r = 0; to && r < rows; ++r)
        for (int c = 0; c < columns; ++c) to[int64_t(r) * columns + c] = float(from[int64_t(r) * padded_columns + c]);
}

void write_weights(const Field& field, const double* sums, const FieldGrad& out) {
    const int f = field.features(), w = field.width, o = field.outputs, fp = field.features_padded(), wp = field.width_padded(),
              op = field.outputs_padded();
    const double *w1 = sums, *b1 = w1 + int64_t(wp) * fp, *w2 = b1 + wp, *b2 = w2 + int64_t(wp) * wp, *w3 = b2 + wp, *b3 = w3 + int64_t(op) * wp;
    write_unpadded(w1, w, f, fp, out.w1), write_unpadded(b1, 1, w, wp, out.b1);
    write_unpadded(w2, w, w, wp, out.w2), write_unpadded(b2, 1, w, wp, out.b2);
    write_unpadded(w3, o, w, wp, out.w3), write_unpadded(b3, 1, o, op, out.b3);
}

}  // namespace

int64_t hidden_floats(const FieldInput& in) { return in.mlp.outputs ? 2 * in.n * padded(in.mlp.width) : 0; }

void field_forward(const FieldInput& in, float* out, float* hidden, int threads) {
    const Prepared prepared(in);
    const Field& field = prepared.field;
    const int width = field.outputs ? field.outputs : field.features();
    const int64_t blocks = (in.n + kBlock - 1) / kBlock;
    const auto run = field_kernels().forward;
#pragma omp parallel num_threads(threads)
    {
        const Array<float> scratch = array<float>(field.scratch());
#pragma omp for schedule(dynamic, 4)
        for (int64_t b = 0; b < blocks; ++b)
            run(field, in.points + 3 * kBlock * b, int(std::min<int64_t>(kBlock, in.n - kBlock * b)), out + width * kBlock * b,
                hidden ? hidden + 2 * field.width_padded() * kBlock * b : nullptr, scratch.get());
    }
}

void field_backward(const FieldInput& in, const float* grad, const float* hidden, const FieldGrad& out, int threads) {
    const Prepared prepared(in);
    const Field& field = prepared.field;
    const int width = field.outputs ? field.outputs : field.features(), levels = field.levels;
    const int64_t weights = field.weights(), plane_values = kChunk * field.channels;
    const FieldKernels& kernels = field_kernels();
    const Array<float> d_values = array<float>(6 * levels * plane_values);
    const Array<Taps> taps = array<Taps>(levels * kChunk);
    const Array<double> sums = array<double>(kGroups * weights);
    std::fill_n(sums.get(), kGroups * weights, 0.0);
    std::vector<Array<float>> d_lines;
    for (int l = 0; l < levels; ++l) {
        const int64_t row = int64_t(field.level[l].resolution) * field.channels;
        std::fill_n(out.space[l], 3 * field.level[l].resolution * row, 0.0f);
        d_lines.push_back(array<float>(3 * row));
        std::fill_n(d_lines[l].get(), 3 * row, 0.0f);
    }
#pragma omp parallel num_threads(threads)
    {
        const Array<float> scratch = array<float>(field.scratch());
        for (int64_t start = 0; start < in.n; start += kChunk) {
            const int64_t count = std::min(kChunk, in.n - start);
#pragma omp for schedule(dynamic, 1)
            for (int g = 0; g < int((count + kBlock - 1) / kBlock); ++g) {
                const int64_t first = int64_t(g) * kBlock;
                const int n = int(std::min<int64_t>(kBlock, count - first));
                kernels.backward(field, in.points + 3 * (start + first), n, grad + width * (start + first),
                                 hidden ? hidden + 2 * field.width_padded() * (start + first) : nullptr, d_values.get() + first * field.channels,
                                 taps.get() + first, sums.get() + g * weights, scratch.get());
            }
            // One thread does each plane, with points in order, so sums are the same for any number of threads.
#pragma omp for schedule(dynamic, 1)
            for (int job = 0; job < 6 * levels; ++job) {
                const int plane = job / levels, l = job % levels;
                kernels.scatter(field, l, plane, taps.get() + l * kChunk, count, d_values.get() + (6 * l + plane) * plane_values, plane < 3 ? out.space[l] : d_lines[l].get());
            }
        }
    }
    for (int g = 1; g < kGroups; ++g)
        for (int64_t k = 0; k < weights; ++k) sums[k] += sums[g * weights + k];
    if (field.outputs) write_weights(field, sums.get(), out);
    for (int l = 0; l < levels; ++l) {
        const int64_t row = int64_t(field.level[l].resolution) * field.channels;
        const int times = in.levels[l].times;
        int64_t low, high;
        float f;
        time_taps(in.t, times, low, high, f);
        std::fill_n(out.time[l], 3 * times * row, 0.0f);
        for (int axis = 0; axis < 3; ++axis) {
            float* plane = out.time[l] + axis * times * row;
            for (int64_t k = 0; k < row; ++k) {
                plane[low * row + k] += (1 - f) * d_lines[l][axis * row + k];
                plane[high * row + k] += f * d_lines[l][axis * row + k];
            }
        }
    }
}

}  // namespace e4dgs
