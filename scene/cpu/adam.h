// Adam (Kingma and Ba 2015) on the rows that got a gradient.
#pragma once
#include <cstdint>
#include <vector>

namespace e4dgs {

struct AdamStep {
    float rate, beta1, beta2, epsilon;
    float correction1, correction2;  // 1 - beta^step
};

// A parameter of `width` columns, and its moments of the same shape. gradient [rows, width] and pace [rows], a factor on the rate of each row, are those
// of row `index[k]` at k, and no row occurs twice; index null: of all rows, in their order; pace null: 1.
struct AdamRows {
    float *parameter, *first, *second;
    const float *gradient, *pace;
    const int64_t* index;
    int64_t rows, width;
    AdamStep step;
};

// One step of each. A row whose gradient is all zero is left unchanged, including its moments.
void adam(const std::vector<AdamRows>& all, int threads);

}  // namespace e4dgs
