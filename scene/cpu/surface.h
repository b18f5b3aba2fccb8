// What keeps surfaces smooth, and where they were measured: two loss terms on the rendered inverse depth, with their gradient in one call.
#pragma once
#include <cstdint>

namespace e4dgs {

// Images are [H, W]. inverse = unit alpha / depth is only looked at where alpha > 1/2 and depth > unit / 1000.
struct SurfaceInput {
    const float *depth, *alpha;
    const float* image;     // [H, W, 3], where its colour changes, surfaces may bend
    const float* measured;  // inverse depth [H, W], 1 / world units, 0 where unknown; or null
    const uint8_t* moving;  // [moving_height, moving_width], 1 where `measured` does not count; or null
    const float* weight;    // factor on the gradient of each pixel; or null
    int height, width, moving_height, moving_width;
    float unit, smooth, measure;  // the viewing distance; weights of the two terms
};

// The sum of both terms. d_depth and d_alpha [H, W] are overwritten. Bit-equal for any number of threads.
double surface(const SurfaceInput& in, float* d_depth, float* d_alpha, int threads);

}  // namespace e4dgs
