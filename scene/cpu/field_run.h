// The deformation field over any number of points, with threads. Results are bit-equal for any number of threads.
#pragma once
#include <cstdint>
#include <vector>

namespace e4dgs {

// Planes of one level: space [3, R, R, C] (xy, xz, yz; the first coordinate varies fastest), time [3, T, R, C] (xt, yt, zt).
struct PlaneLevel {
    const float *space, *time;
    int resolution, times;
};

// A perceptron in torch's layout: weights [out, in]. outputs == 0: no perceptron, the features are the output.
struct Perceptron {
    int width = 0, outputs = 0;
    const float *w1 = nullptr, *b1 = nullptr, *w2 = nullptr, *b2 = nullptr, *w3 = nullptr, *b3 = nullptr;
};

struct FieldInput {
    std::vector<PlaneLevel> levels;
    int channels;
    Perceptron mlp;
    const float* points;  // [n, 3] world units, clamped to the box
    float low[3], high[3];
    int64_t n;
    float t;  // in [0, 1], clamped
};

struct FieldGrad {  // overwritten; shapes as in the input
    std::vector<float*> space, time;
    float *w1 = nullptr, *b1 = nullptr, *w2 = nullptr, *b2 = nullptr, *w3 = nullptr, *b3 = nullptr;
};

// out [n, outputs], or [n, levels * C] without a perceptron; grad likewise. hidden [hidden_floats]: what forward stores for backward; null in
// forward if there will be no backward.
int64_t hidden_floats(const FieldInput& in);
void field_forward(const FieldInput& in, float* out, float* hidden, int threads);
void field_backward(const FieldInput& in, const float* grad, const float* hidden, const FieldGrad& out, int threads);

}  // namespace e4dgs
