// The deformation field for one instruction set: a field_*.cpp defines E4DGS_ISA and includes this. Vectors are the compiler's own,
// as wide as the set allows; products and sums contract to fused ones where it has them.
#include "field.h"

namespace E4DGS_ISA {
namespace {

using namespace e4dgs;

#if defined(__AVX512F__)
constexpr int kWidth = 16, kPanel = 4;  // floats of a vector; vectors of a row that are summed in registers
#elif defined(__AVX2__)
constexpr int kWidth = 8, kPanel = 2;
#else
constexpr int kWidth = 4, kPanel = 2;
#endif
constexpr int kRows = 4;  // rows that are summed in registers
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

// Features, hidden layers and outputs of n points; the rows from n on to a whole number of kRows repeat point 0's.
template <int C>
void activate(const Field& field, const float* u, int n, const Scratch& s) {
    const int f = field.features_padded(), w = field.width_padded(), o = field.outputs_padded(), rows = (n + kRows - 1) / kRows * kRows;
    for (int i = 0; i < rows; ++i) {
        float* row = s.features + i * f;
        for (int c = field.features(); c < f; ++c) row[c] = 0.0f;
        for (int l = 0; l < field.levels; ++l)
            features_of_level<C>(field, l, u + 3 * (i < n ? i : 0), s.values + (int64_t(i) * field.levels + l) * 6 * field.channels, row + l * field.channels);
    }
    if (!field.outputs) return;
    layer<true>(s.features, f, rows, field.w1_t, w, f, field.b1, s.hidden1);
    layer<true>(s.hidden1, w, rows, field.w2_t, w, w, field.b2, s.hidden2);
    layer<false>(s.hidden2, w, rows, field.w3_t, o, w, field.b3, s.outputs);
}

template <int C>
void forward_block(const Field& field, const float* u, int n, float* out, float* scratch) {
    const Scratch s = divide(field, scratch);
    activate<C>(field, u, n, s);
    const float* from = field.outputs ? s.outputs : s.features;
    const int width = field.outputs ? field.outputs : field.features(), stride = padded(width);
    for (int i = 0; i < n; ++i) __builtin_memcpy(out + int64_t(i) * width, from + i * stride, sizeof(float) * std::size_t(width));
}

template <int C>
void backward_block(const Field& field, const float* u, int n, const float* grad, float* d_values, double* weights, float* scratch) {
    const Scratch s = divide(field, scratch);
    activate<C>(field, u, n, s);
    const int f = field.features_padded(), w = field.width_padded(), o = field.outputs_padded(), rows = (n + kRows - 1) / kRows * kRows;
    const int width = field.outputs ? field.outputs : field.features(), stride = padded(width);
    float* d_out = field.outputs ? s.d_outputs : s.d_features;
    for (int i = 0; i < rows; ++i)
        for (int c = 0; c < stride; ++c) d_out[i * stride + c] = i < n && c < width ? grad[int64_t(i) * width + c] : 0.0f;
    if (field.outputs) {
        const WeightGrads g(field, weights);
        add_products(s.d_outputs, o, s.hidden2, w, rows, g.w3), add_columns(s.d_outputs, o, rows, g.b3);
        back(s.d_outputs, o, rows, field.w3, w, s.hidden2, s.d_hidden2);
        add_products(s.d_hidden2, w, s.hidden1, w, rows, g.w2), add_columns(s.d_hidden2, w, rows, g.b2);
        back(s.d_hidden2, w, rows, field.w2, w, s.hidden1, s.d_hidden1);
        add_products(s.d_hidden1, w, s.features, f, rows, g.w1), add_columns(s.d_hidden1, w, rows, g.b1);
        back(s.d_hidden1, w, rows, field.w1, f, nullptr, s.d_features);
    }
    const int64_t each = int64_t(field.levels) * 6 * field.channels;
    for (int i = 0; i < n; ++i)
        for (int l = 0; l < field.levels; ++l)
            product_backward<C>(field, s.values + i * each + l * 6 * field.channels, s.d_features + i * f + l * field.channels,
                                d_values + (int64_t(l) * 6 * kChunk + i) * field.channels);
}

// The usual numbers of channels are known to the compiler.
#define E4DGS_CHANNELS(call)                  \
    switch (field.channels) {                 \
        case 16: return call<16>;             \
        case 32: return call<32>;             \
        default: return call<0>;              \
    }

void forward_any(const Field& field, const float* u, int n, float* out, float* scratch) {
    const auto run = [&] { E4DGS_CHANNELS(forward_block) }();
    run(field, u, n, out, scratch);
}

void backward_any(const Field& field, const float* u, int n, const float* grad, float* d_values, double* weights, float* scratch) {
    const auto run = [&] { E4DGS_CHANNELS(backward_block) }();
    run(field, u, n, grad, d_values, weights, scratch);
}

void scatter_any(const Field& field, int level, int plane, const float* u, int64_t n, const float* d_values, float* grad) {
    const auto run = [&] { E4DGS_CHANNELS(scatter) }();
    run(field, level, plane, u, n, d_values, grad);
}

#undef E4DGS_CHANNELS

}  // namespace

extern const FieldKernels kFieldKernels;
const FieldKernels kFieldKernels = {&forward_any, &backward_any, &scatter_any};

}  // namespace E4DGS_ISA
