// The deformation field for one instruction set: each field_*.cpp defines E4DGS_ISA and includes this file. It uses compiler vector types, as wide
// as the instruction set allows; multiply-adds contract to fused ones if it has them.
#include "field.h"

namespace E4DGS_ISA {
namespace {

using namespace e4dgs;

#if defined(__AVX512F__)
constexpr int kWidth = 16, kPanel = 4;  // floats per vector; vectors of a row that are accumulated in registers
#elif defined(__AVX2__)
constexpr int kWidth = 8, kPanel = 2;
#else
constexpr int kWidth = 4, kPanel = 2;
#endif
constexpr int kRows = 4;  // rows that are accumulated in registers
typedef float Vec __attribute__((vector_size(4 * kWidth)));
typedef float Loose __attribute__((vector_size(4 * kWidth), aligned(4)));
typedef int32_t Bits __attribute__((vector_size(4 * kWidth)));

inline Vec load(const float* p) { return *reinterpret_cast<const Loose*>(p); }
inline void store(float* p, Vec v) { *reinterpret_cast<Loose*>(p) = v; }
inline Vec all(float x) { return x - Vec{}; }

#include "field_planes.inl"
#include "field_layers.inl"

struct Scratch {  // of one block; rows padded
    float *values, *features, *hidden1, *hidden2, *outputs, *d_outputs, *d_hidden2, *d_hidden1, *d_features;
};

inline Scratch divide(const Field& field, float* at) {
    const int f = field.features_padded(), w = field.width_padded(), o = field.outputs_padded();
    const auto next = [&at](int width) {
        float* here = at;
        at += kBlock * width;
        return here;
    };
    return {next(6 * f), next(f), next(w), next(w), next(o), next(o), next(w), next(w), next(f)};
}

inline int whole_rows(int n) { return (n + kRows - 1) / kRows * kRows; }

// Features of n points and the six values whose product they are. Rows from n up to a multiple of kRows repeat those of point 0. taps may be null.
template <int C>
void look_up(const Field& field, const float* points, int n, const Scratch& s, Taps* taps) {
    const int f = field.features_padded();
    for (int i = 0; i < whole_rows(n); ++i) {
        float* row = s.features + i * f;
        for (int c = field.features(); c < f; ++c) row[c] = 0.0f;
        for (int l = 0; l < field.levels; ++l) {
            const Taps here = taps_of(field, points + 3 * (i < n ? i : 0), field.level[l].resolution);
            features_of_level<C>(field, l, here, s.values + (int64_t(i) * field.levels + l) * 6 * field.channels, row + l * field.channels);
            if (taps && i < n) taps[l * kChunk + i] = here;
        }
    }
}

template <int C>
void forward_block(const Field& field, const float* points, int n, float* out, float* hidden, float* scratch) {
    const Scratch s = divide(field, scratch);
    look_up<C>(field, points, n, s, nullptr);
    const int f = field.features_padded(), w = field.width_padded(), o = field.outputs_padded(), rows = whole_rows(n);
    if (field.outputs) {
        const bool in_place = hidden && rows == n;
        float *hidden1 = in_place ? hidden : s.hidden1, *hidden2 = in_place ? hidden + int64_t(n) * w : s.hidden2;
        layer<true>(s.features, f, rows, field.w1_t, w, f, field.b1, hidden1);
        layer<true>(hidden1, w, rows, field.w2_t, w, w, field.b2, hidden2);
        layer<false>(hidden2, w, rows, field.w3_t, o, w, field.b3, s.outputs);
        const std::size_t bytes = sizeof(float) * std::size_t(n) * std::size_t(w);
        if (hidden && !in_place) __builtin_memcpy(hidden, hidden1, bytes), __builtin_memcpy(hidden + int64_t(n) * w, hidden2, bytes);
    }
    const float* from = field.outputs ? s.outputs : s.features;
    const int width = field.outputs ? field.outputs : field.features(), stride = padded(width);
    for (int i = 0; i < n; ++i) __builtin_memcpy(out + int64_t(i) * width, from + i * stride, sizeof(float) * std::size_t(width));
}

template <int C>
void backward_block(const Field& field, const float* points, int n, const float* grad, const float* hidden, float* d_values, Taps* taps,
                    double* weights, float* scratch) {
    const Scratch s = divide(field, scratch);
    look_up<C>(field, points, n, s, taps);
    const int f = field.features_padded(), w = field.width_padded(), o = field.outputs_padded(), rows = whole_rows(n);
    const int width = field.outputs ? field.outputs : field.features(), stride = padded(width);
    float* d_out = field.outputs ? s.d_outputs : s.d_features;
    for (int i = 0; i < rows; ++i)
        for (int c = 0; c < stride; ++c) d_out[i * stride + c] = i < n && c < width ? grad[int64_t(i) * width + c] : 0.0f;
    if (field.outputs) {
        const float *hidden1 = hidden, *hidden2 = hidden + int64_t(n) * w;
        if (rows != n) {  // the last block: the layers read a multiple of kRows rows
            const std::size_t bytes = sizeof(float) * std::size_t(n) * std::size_t(w), rest = sizeof(float) * std::size_t(rows - n) * std::size_t(w);
            __builtin_memcpy(s.hidden1, hidden1, bytes), __builtin_memset(s.hidden1 + n * w, 0, rest);
            __builtin_memcpy(s.hidden2, hidden2, bytes), __builtin_memset(s.hidden2 + n * w, 0, rest);
            hidden1 = s.hidden1, hidden2 = s.hidden2;
        }
        const WeightGrads g(field, weights);
        add_products(s.d_outputs, o, field.outputs, hidden2, w, rows, g.w3), add_columns(s.d_outputs, o, rows, g.b3);
        back(s.d_outputs, o, field.outputs, rows, field.w3, w, hidden2, s.d_hidden2);
        add_products(s.d_hidden2, w, field.width, hidden1, w, rows, g.w2), add_columns(s.d_hidden2, w, rows, g.b2);
        back(s.d_hidden2, w, field.width, rows, field.w2, w, hidden1, s.d_hidden1);
        add_products(s.d_hidden1, w, field.width, s.features, f, rows, g.w1), add_columns(s.d_hidden1, w, rows, g.b1);
        back(s.d_hidden1, w, field.width, rows, field.w1, f, nullptr, s.d_features);
    }
    for (int i = 0; i < n; ++i)
        for (int l = 0; l < field.levels; ++l)
            product_backward<C>(field, s.values + (int64_t(i) * field.levels + l) * 6 * field.channels, s.d_features + i * f + l * field.channels,
                                d_values + (int64_t(l) * 6 * kChunk + i) * field.channels);
}

// The usual numbers of channels are compile-time constants.
#define E4DGS_CHANNELS(call)                  \
    switch (field.channels) {                 \
        case 16: return call<16>;             \
        case 32: return call<32>;             \
        default: return call<0>;              \
    }

void forward_any(const Field& field, const float* points, int n, float* out, float* hidden, float* scratch) {
    const auto run = [&] { E4DGS_CHANNELS(forward_block) }();
    run(field, points, n, out, hidden, scratch);
}

void backward_any(const Field& field, const float* points, int n, const float* grad, const float* hidden, float* d_values, Taps* taps,
                  double* weights, float* scratch) {
    const auto run = [&] { E4DGS_CHANNELS(backward_block) }();
    run(field, points, n, grad, hidden, d_values, taps, weights, scratch);
}

void scatter_any(const Field& field, int level, int plane, const Taps* taps, int64_t n, const float* d_values, float* grad) {
    const auto run = [&] { E4DGS_CHANNELS(scatter) }();
    run(field, level, plane, taps, n, d_values, grad);
}

#undef E4DGS_CHANNELS

}  // namespace

extern const FieldKernels kFieldKernels;
const FieldKernels kFieldKernels = {&forward_any, &backward_any, &scatter_any};

}  // namespace E4DGS_ISA
