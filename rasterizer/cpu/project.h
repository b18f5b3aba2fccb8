// The interface of the kernels from primitives to records and back, many at a time. They are compiled once for each instruction set. Plain
// data only, as in blend.h.
#pragma once
#include <cstdint>

#include "records.h"
#include "scene.h"

namespace e4dgs {

constexpr double kSlack = 1e-4;  // supports are enlarged by this much (in exponents) so that rounding never cuts a visible pixel
constexpr int kProjectBlock = 256;  // primitives that are processed together; a multiple of every vector width

template <class Record>
struct ProjectJob {
    const SceneInput* scene;
    Record* records;
    double* depth;  // NaN if culled
    TileBox* boxes;
};

template <class Record, class Grad>
struct BackprojectJob {
    const SceneInput* scene;
    const Record* records;
    const uint32_t* slot_begin;
    const float* slots;
    const uint8_t* touched;
    uint32_t units;  // size of a slot
    bool extras;     // whether the slots contain gradients of extras
    Grad out;
};

struct SpanJob {
    const GaussianRecord* records;
    const TileBox* boxes;
    const uint32_t* begin;  // for each Gaussian, where its rows begin in `spans`
    Span* spans;
    int width, height;      // px
};

using ProjectGaussians = ProjectJob<GaussianRecord>;
using ProjectConvexes = ProjectJob<ConvexRecord>;
using BackprojectGaussians = BackprojectJob<GaussianRecord, GaussianGrad>;
using BackprojectConvexes = BackprojectJob<ConvexRecord, ConvexGrad>;

// All except spans process the primitives first..last, at most kProjectBlock of them. camera [16] is written; it may be null.
struct ProjectKernels {
    void (*gaussians)(const ProjectGaussians&, int64_t first, int64_t last);
    void (*convexes)(const ProjectConvexes&, int64_t first, int64_t last);
    void (*spans)(const SpanJob&, const uint32_t* ids, int64_t count);
    void (*gaussians_back)(const BackprojectGaussians&, int64_t first, int64_t last, double* camera);
    void (*convexes_back)(const BackprojectConvexes&, int64_t first, int64_t last, double* camera);
};

const ProjectKernels& project_kernels();  // for the same instruction set as kernels()

}  // namespace e4dgs
