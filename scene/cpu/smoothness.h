// Total variation of feature planes (lambda_3's term of Eq. 9), value and gradient in one pass.
#pragma once
#include <cstdint>

namespace e4dgs {

// One stack of three planes [3, rows, columns, channels].
struct PlaneStack {
    const float* values;
    int64_t rows, columns, channels;
    bool second;  // along rows, second differences instead of first ones
    float* grad;  // written
};

// Sum over the stacks of mean squared differences along columns and along rows (none where there are too few samples).
double smoothness(const PlaneStack* stacks, int count, int threads);

}  // namespace e4dgs
