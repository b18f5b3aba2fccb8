// Gaussians to records and back, for one instruction set: a project_*.cpp defines E4DGS_ISA, includes its simd_*.h and then
// this. math/ is instantiated for Pack alone: an instance for double would be shared with other translation units, and the linker
// could keep the copy that older processors cannot run.
#include "pack.h"
//
#include "gaussian.h"
#include "project.h"
#include "sh.h"

namespace E4DGS_ISA {
namespace {

using namespace e4dgs;

#include "elementary.inl"

constexpr double kLargest = 3.4028234663852886e38;  // of a float

inline Camera<Pack> camera_of(const Camera<double>& from) {
    Camera<Pack> to;
    to.fx = from.fx, to.fy = from.fy, to.cx = from.cx, to.cy = from.cy, to.near_z = from.near_z;
    to.width = from.width, to.height = from.height;
    for (int i = 0; i < 9; ++i) to.R[i] = from.R[i];
    for (int i = 0; i < 3; ++i) to.t[i] = from.t[i], to.centre[i] = from.centre[i];
    return to;
}

// Rows of `width` floats at the indices, one a lane: columns[c] holds column c.
template <int WIDTH>
inline void load_rows(const float* from, const int64_t* index, Pack* columns) {
    alignas(64) double lanes[WIDTH][kLanes];
    for (int l = 0; l < kLanes; ++l)
        for (int c = 0; c < WIDTH; ++c) lanes[c][l] = double(from[index[l] * WIDTH + c]);
    for (int c = 0; c < WIDTH; ++c) columns[c] = *reinterpret_cast<const Doubles*>(lanes[c]);
}

inline void store_lanes(Pack from, double* to) { *reinterpret_cast<Doubles*>(to) = from.v; }

inline bool finite(const float* x, int64_t n) {
    uint32_t bad = 0;  // on the bits, so that the loop is vectorised
    for (int64_t i = 0; i < n; ++i) {
        uint32_t word;
        __builtin_memcpy(&word, x + i, 4);
        bad |= uint32_t((word & 0x7f800000u) == 0x7f800000u);
    }
    return bad == 0;
}

template <int WIDTH>
inline Truths bounded(const Pack* columns) {
    Truths good = fabs(columns[0]) <= Pack(kLargest);
    for (int c = 1; c < WIDTH; ++c) good = good & (fabs(columns[c]) <= Pack(kLargest));
    return good;
}

inline int floor_of(double a) { return int(a); }                            // a >= 0
inline int ceil_of(double a) { return int(a) + (a > double(int(a))); }      // a > -1

#include "project_colour.inl"
#include "project_forward.inl"
#include "project_backward.inl"

}  // namespace

extern const ProjectKernels kProjectKernels;
const ProjectKernels kProjectKernels = {&project_block, &backproject_block};

}  // namespace E4DGS_ISA
