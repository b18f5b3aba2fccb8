// Gaussians to records and back, many at a time, compiled once for each instruction set. Plain data only, as in blend.h.
#pragma once
#include <cstdint>

#include "records.h"
#include "scene.h"

namespace e4dgs {

constexpr double kSlack = 1e-4;  // supports are enlarged by this much (in exponents) so that rounding never cuts a visible pixel
constexpr int kProjectBlock = 256;  // primitives that are worked on together; a multiple of every vector's width

struct ProjectJob {
    const SceneInput* scene;
    GaussianRecord* records;
    double* depth;  // NaN where culled
    TileBox* boxes;
};

struct BackprojectJob {
    const SceneInput* scene;
    const GaussianRecord* records;
    const uint32_t* slot_begin;
    const float* slots;
    const uint8_t* touched;
    uint32_t units;  // of a slot
    bool extras;     // they carry gradients
    GaussianGrad out;
};

// Both work on the Gaussians first..last, at most kProjectBlock of them.
struct ProjectKernels {
    void (*project)(const ProjectJob&, int64_t first, int64_t last);
    void (*backproject)(const BackprojectJob&, int64_t first, int64_t last, double* camera);  // camera [16] is written, may be null
};

const ProjectKernels& project_kernels();  // of the same instruction set as kernels()

}  // namespace e4dgs
