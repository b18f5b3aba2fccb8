// The image terms on two backgrounds, and the L1 of alpha, with the gradient in one call.
#pragma once
#include "photometric.h"

namespace e4dgs {

// The same comparison in front of the opposite background.
struct Opposite {
    const float *alpha, *known;  // [H,W], of the render and of the capture
    const bool* kept;            // [H,W], or null: the others are equal in front of that background, and their alpha does not count
    float change[3];             // opposite background minus the one that was rendered
    float share;                 // of the opposite background in the photometric loss
    float w_alpha;               // of mean |alpha - known|
};

struct Appearance {
    double loss, d_gain[3], d_offset[3];
};

// (1 - share) * L(x, y) + share * L(x', y') + w_alpha * mean |alpha - known|, where L = w_l1 * l1 + w_ssim * (1 - ssim) as in `photometric`, which
// see for the other arguments, and x' = x + (1 - alpha) * change. grad_alpha [H,W] receives the gradient of alpha.
Appearance appearance(const float* x, const float* y, const float* weight, const Recording* recording, const Opposite& other, int height, int width,
                      float w_l1, float w_ssim, float* grad, float* grad_alpha, int threads);

}  // namespace e4dgs
