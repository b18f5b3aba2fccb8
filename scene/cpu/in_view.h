// Which Gaussians one view may show, found in a fraction of the time that projecting them takes.
#pragma once
#include <cstdint>

namespace e4dgs {

struct ViewedGaussians {
    int64_t n;
    const float* means;           // [n, 3] world units, at the middle of the life
    const float* log_scales;      // [n, 3]
    const float* opacity_logits;  // [n]
    const float *times, *log_spans, *velocities;  // as in `Lives`; null if nothing moves
    const bool* dynamic;          // [n]
    float frame;                  // the moment
    float fuller = 1.0f;          // at most so many times as opaque will they be drawn
};

struct Seeing {
    double fx, fy, cx, cy, near;
    double pose[12];       // cam_from_world, the first three rows
    int width, height;     // px
    const bool* tiles;     // [rows, columns] what is drawn; null: everything
    int rows, columns, tile;  // of which size, px
};

// Writes to `index` [n], in ascending order, every Gaussian that can contribute to a drawn pixel, and some that do not. Returns their number.
int64_t in_view(const ViewedGaussians& gaussians, const Seeing& view, int64_t* index, int threads);

}  // namespace e4dgs
