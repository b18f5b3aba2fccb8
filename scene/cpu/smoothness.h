// Total variation of feature planes (the term of lambda_3 in Eq. 9), value and gradient in one pass.
#pragma once
#include <cstdint>

namespace e4dgs {

// One stack of three planes [3, rows, columns, channels].
struct PlaneStack {
    const float* values;
    int64_t rows, columns, channels;
    bool second;  // whether differences from row to row are second ones instead of first ones
    float* grad;  // overwritten
};

// Sum over the stacks of the mean squared differences between neighbouring columns and between rows (zero if there are too few samples).
double smoothness(const PlaneStack* stacks, int count, int threads);

}  // namespace e4dgs
