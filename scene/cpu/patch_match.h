// Depth from several images by slanted windows: each pixel looks for the plane whose patch agrees best with the other images.
#pragma once
#include <cstdint>

namespace e4dgs {

constexpr int kMostOthers = 8;

// Images are [height, width], grey levels. A plane at a pixel is an inverse depth at its centre and its change per pixel in x and y; inverse
// depth is linear over the image of a plane. The pixel (x, y, 1) at inverse depth w lies at to[j] (x, y, 1, w) in image j, times its depth there.
struct Patches {
    const float* image;
    const float* others;  // [count, height, width]
    const float* to;      // [count, 3, 4]
    int count, best;      // images; how many count, those that agree best: the others may not see the place
    int height, width;
    float low, high, step;  // range of the inverse depth; a difference that does not matter much
    float focal;            // px, for the size of slants
    const bool* wanted;     // [height, width], pixels that count; or null, if all do
};

// Improves planes [3, height, width] (inverse depth, its change in x, its change in y) in place, in as many iterations; score [height, width]:
// the correlation that they reach, -1 to 1. With no iteration only the score is computed. Bit-equal for any number of threads.
void patch_match(const Patches& in, int iterations, float* planes, float* score, int threads);

}  // namespace e4dgs
