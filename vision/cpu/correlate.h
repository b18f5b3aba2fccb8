// RAFT's correlation look-up without the volume of all pairs.
#pragma once
#include <cstdint>

namespace e4dgs {

constexpr int kMaxRadius = 8;

struct CorrelationLevel {
    const float* features;  // [height, width, channels]
    int height, width;
};

// first [n, channels], at [n, 2] (x, y) in features of level 0. out [n, levels, side, side] with side = 2 radius + 1, offset in x slowest:
// products of first with the level's features around at / 2^level, bilinear, zero outside; zero where a place is not finite.
void correlate(const float* first, const CorrelationLevel* levels, int n_levels, const float* at, int64_t n, int channels, int radius, float* out,
               int threads);

}  // namespace e4dgs
