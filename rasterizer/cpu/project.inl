// Converts primitives to records and back, for one instruction set: a project_*.cpp defines E4DGS_ISA, includes its simd_*.h and then
// this file. math/ is instantiated only for Pack: an instance for double would be shared with other translation units, and the linker
// could keep a copy that older processors cannot run.
#include "pack.h"
//
#include "convex.h"
#include "gaussian.h"
#include "hull.h"
#include "project.h"
#include "sh.h"

namespace E4DGS_ISA {
namespace {

using namespace e4dgs;

#include "elementary.inl"

constexpr double kLargest = 3.4028234663852886e38;  // largest float

inline Camera<Pack> camera_of(const Camera<double>& from) {
    Camera<Pack> to;
    to.fx = from.fx, to.fy = from.fy, to.cx = from.cx, to.cy = from.cy, to.near_z = from.near_z;
    to.width = from.width, to.height = from.height;
    for (int i = 0; i < 9; ++i) to.R[i] = from.R[i];
    for (int i = 0; i < 3; ++i) to.t[i] = from.t[i], to.centre[i] = from.centre[i];
    for (int i = 0; i < 2; ++i) to.low[i] = from.low[i], to.high[i] = from.high[i];
    return to;
}

inline Pack lanes_of(const double* from) { return *reinterpret_cast<const Doubles*>(from); }

// Loads the rows of `width` floats at the indices, one row per lane; columns[c] receives column c.
__attribute__((always_inline)) inline void load_rows(const float* from, int width, const int64_t* index, Pack* columns) {
    for (int l = 0; l < kLanes; ++l)
        for (int c = 0; c < width; ++c) reinterpret_cast<double*>(columns)[c * kLanes + l] = double(from[index[l] * width + c]);
}

inline void store_lanes(Pack from, double* to) { *reinterpret_cast<Doubles*>(to) = from.v; }

inline bool finite(const float* x, int64_t n) {
    uint32_t bad = 0;  // tested on the bits, so that the loop is vectorised
    for (int64_t i = 0; i < n; ++i) {
        uint32_t word;
        __builtin_memcpy(&word, x + i, 4);
        bad |= uint32_t((word & 0x7f800000u) == 0x7f800000u);
    }
    return bad == 0;
}

inline Truths bounded(const Pack* columns, int width) {
    Truths good = fabs(columns[0]) <= Pack(kLargest);
    for (int c = 1; c < width; ++c) good = good & (fabs(columns[c]) <= Pack(kLargest));
    return good;
}

inline bool usable(const Looks& in, int64_t i, int extras) {
    const int64_t sh = int64_t(in.degree + 1) * (in.degree + 1) * 3;
    if (in.sh ? !finite(in.sh + i * sh, sh) : !finite(in.colors + i * 3, 3)) return false;
    return !in.extras || finite(in.extras + i * extras, extras);
}

inline int floor_of(double a) { return int(a); }                            // a >= 0
inline int ceil_of(double a) { return int(a) + (a > double(int(a))); }      // a > -1

// The tiles that a range of pixel coordinates within the image overlaps. Returns false if the range contains no pixel centre.
inline bool tile_box(double low_x, double high_x, double low_y, double high_y, TileBox& box) {
    // Tile t contains the pixel centres kTile t + 0.5 ... kTile t + kTile - 0.5.
    const int x0 = ceil_of((low_x - (kTile - 0.5)) / kTile), x1 = floor_of((high_x - 0.5) / kTile) + 1;
    const int y0 = ceil_of((low_y - (kTile - 0.5)) / kTile), y1 = floor_of((high_y - 0.5) / kTile) + 1;
    if (x0 >= x1 || y0 >= y1) return false;
    box = {uint16_t(x0), uint16_t(x1), uint16_t(y0), uint16_t(y1)};
    return true;
}

// Whether something is drawn in any tile of the box.
inline bool drawn(const SceneInput& scene, const TileBox& box) {
    if (!scene.tiles) return true;
    const int across = (scene.camera.width + kTile - 1) / kTile;
    for (int y = box.y0; y < box.y1; ++y)
        for (int x = box.x0; x < box.x1; ++x)
            if (scene.tiles[y * across + x]) return true;
    return false;
}

#include "project_colour.inl"
#include "project_slots.inl"
#include "project_gaussians.inl"
#include "project_gaussians_back.inl"
#include "project_spans.inl"
#include "project_hull.inl"
#include "project_convexes.inl"
#include "project_convexes_back.inl"

}  // namespace

extern const ProjectKernels kProjectKernels;
const ProjectKernels kProjectKernels = {&project_gaussians, &project_convexes, &gaussian_spans, &backproject_gaussians, &backproject_convexes};

}  // namespace E4DGS_ISA
