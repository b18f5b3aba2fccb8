// Adam (Kingma and Ba 2015) on the rows that got a gradient.
#pragma once
#include <cstdint>

namespace e4dgs {

struct AdamStep {
    float rate, beta1, beta2, epsilon;
    float correction1, correction2;  // 1 - beta^step
};

// parameter, gradient, first, second [rows, width]. A row whose gradient is all zero is left unchanged, including its moments. pace [rows]: a
// factor on the rate of each row; null: 1.
void adam_rows(float* parameter, const float* gradient, float* first, float* second, const float* pace, int64_t rows, int64_t width, const AdamStep& step,
               int threads);

// The same for some rows of parameter, first and second. gradient [count, width] and pace [count]: those of row `index[k]` are at k. No row occurs twice.
void adam_chosen(float* parameter, const float* gradient, float* first, float* second, const float* pace, const int64_t* index, int64_t count, int64_t width,
                 const AdamStep& step, int threads);

}  // namespace e4dgs
