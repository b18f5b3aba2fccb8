// The deformation field: six-plane look-up at every level, product, concatenation, and a perceptron with two hidden layers, in one
// pass over blocks of points. Plain data only: this is included by the kernels of every instruction set.
#pragma once
#include <cstddef>
#include <cstdint>

namespace e4dgs {

constexpr int kMaxLevels = 8;
constexpr int kMaxChannels = 64;
constexpr int kBlock = 96;         // points that one thread takes through all layers at a time
constexpr int kGroups = 32;        // blocks of a chunk, each with its own sums of the weight gradients
constexpr int64_t kChunk = int64_t(kBlock) * kGroups;  // points between two scatters to the planes; few enough that their gradients stay in cache
constexpr int kPad = 16;           // rows of scratch are padded to whole vectors

constexpr int padded(int n) { return (n + kPad - 1) / kPad * kPad; }

// One resolution level at one time. space [3, R, R, C] (xy, xz, yz; the first coordinate varies fastest); lines [3, R, C]: the time
// planes interpolated at that time.
struct Level {
    const float *space, *lines;
    int resolution;
};

// The field as the kernels read it, with weights padded with zeros. Without a perceptron (outputs == 0) the features are the output.
struct Field {
    Level level[kMaxLevels];
    int levels, channels;
    float low[3], inverse_size[3];  // of the box: planes are looked up at (point - low) * inverse_size
    int width = 0, outputs = 0;
    const float *w1_t, *w2_t, *w3_t;  // [F, W], [W, W], [W, O], padded: forward
    const float *w1, *w2, *w3;        // [W, F], [W, W], [O, W], padded: backward
    const float *b1, *b2, *b3;        // padded

    int features() const { return levels * channels; }
    int features_padded() const { return padded(features()); }
    int width_padded() const { return padded(width); }
    int outputs_padded() const { return padded(outputs); }
    int64_t weights() const {  // number of gradients of all layers' weights, padded
        return int64_t(width_padded()) * (features_padded() + width_padded() + 2) + int64_t(outputs_padded()) * (width_padded() + 1);
    }
    int64_t scratch() const {  // number of floats that a thread needs, aligned to 64 bytes
        return int64_t(kBlock) * (6 * features_padded() + 2 * features_padded() + 4 * width_padded() + 2 * outputs_padded()) + kPad;
    }
};

// Two neighbouring samples on each axis: low and low + 1, or low alone if a line has only one sample.
struct Taps {
    int low[3];
    float fraction[3];
};

struct FieldKernels {
    // points [n, 3] world units, n <= kBlock; out [n, outputs or features]; hidden (may be null) receives both layers [2, n, width padded].
    void (*forward)(const Field&, const float* points, int n, float* out, float* hidden, float* scratch);
    // grad has the shape of out; hidden is what forward stored. d_values [levels, 6, kChunk, C] and taps [levels, kChunk] are written from
    // row 0 on; weights (sums in double, layout of WeightGrads) are added to.
    void (*backward)(const Field&, const float* points, int n, const float* grad, const float* hidden, float* d_values, Taps* taps, double* weights,
                     float* scratch);
    // Adds the gradients of plane `plane` (0-2 space, 3-5 lines) of a level: n points in order, taps [n], d_values [n, C].
    void (*scatter)(const Field&, int level, int plane, const Taps* taps, int64_t n, const float* d_values, float* grad);
};

const FieldKernels& field_kernels();            // the best that this processor supports
bool select_field_kernels(const char* name);     // for tests and benchmarks; false if the processor does not support it

}  // namespace e4dgs
