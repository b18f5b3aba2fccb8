// The arguments from Python as plain pointers. All arrays are C-contiguous float32. A null pointer means "not given" for
// an input and "not requested" for a gradient.
#pragma once
#include <cstdint>

#include "camera.h"

namespace e4dgs {

struct Looks {
    const float* opacities = nullptr;  // [n]
    const float* sh = nullptr;         // [n, (degree+1)^2, 3]
    const float* colors = nullptr;     // [n, 3]; exactly one of sh and colors is given
    const float* extras = nullptr;     // [n, E]
    int degree = 0;
};

struct GaussianInput : Looks {
    int64_t n = 0;
    const float *means = nullptr, *quats = nullptr, *scales = nullptr;  // [n, 3], [n, 4], [n, 3]
};

struct ConvexInput : Looks {
    int64_t n = 0;
    int points_each = 3;
    const float *points = nullptr, *tau = nullptr, *kappa = nullptr;  // [n, K, 3], [n], [n]
};

struct SceneInput {
    Camera<double> camera;
    GaussianInput gaussians;
    ConvexInput convexes;
    int extras = 0;  // number of channels E
    float background[3] = {0, 0, 0};
    bool antialiased = false;
    const uint8_t* tiles = nullptr;  // [tiles] 0 where nothing is drawn; null: everything is
};

struct FrameOutput {
    float* color = nullptr;   // [H, W, 3]
    float* alpha = nullptr;   // [H, W]
    float* depth = nullptr;   // [H, W]
    float* extras = nullptr;  // [H, W, E]
    uint8_t *visible_gaussians = nullptr, *visible_convexes = nullptr;
};

struct FrameGrad {  // null counts as zero
    const float *color = nullptr, *alpha = nullptr, *depth = nullptr, *extras = nullptr;
    const float *alpha_image = nullptr, *depth_image = nullptr;  // images of the frame; needed if `depth` is given
};

struct LooksGrad {
    float *opacities = nullptr, *sh = nullptr, *colors = nullptr, *extras = nullptr;
};

struct GaussianGrad : LooksGrad {
    float *means = nullptr, *quats = nullptr, *scales = nullptr;
};

struct ConvexGrad : LooksGrad {
    float *points = nullptr, *tau = nullptr, *kappa = nullptr;
};

struct SceneGrad {
    GaussianGrad gaussians;
    ConvexGrad convexes;
    double* camera = nullptr;      // fx fy cx cy, then the 3x4 of cam_from_world
    double* background = nullptr;  // [3]
};

}  // namespace e4dgs
