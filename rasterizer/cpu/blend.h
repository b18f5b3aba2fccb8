// The interface for blending one tile, compiled once for each instruction set. Plain data only: nothing here may instantiate a template
// that other translation units share, or the linker could keep a copy that older processors cannot run.
#pragma once
#include <cstdint>

#include "records.h"

namespace e4dgs {

struct TileJob {
    int width, height, tiles_x;
    uint32_t n_gaussians;
    int points;  // number of points of every convex
    const GaussianRecord* gaussians;
    const ConvexRecord* convexes;
    const float *gaussian_extras, *convex_extras;  // [n, extras] or null
    int extras;
    const uint64_t* tile_begin;
    const Entry* entries;
    uint16_t* masks;
    float background[3];
    float* transmittance;  // [H, W], may be null in the forward pass
    int32_t* last;
};

struct ForwardJob : TileJob {
    float *color, *alpha, *depth, *extra;  // the frame
    uint8_t *visible_gaussians, *visible_convexes;
};

struct BackwardJob : TileJob {
    const float *grad_color, *grad_alpha, *grad_depth, *grad_extras;  // gradients of the frame; each may be null
    const float *alpha, *depth;                                      // images of the frame; read only if grad_depth is given
    float* slots;        // gradients of each (tile, primitive) pair
    uint8_t* touched;    // [units] 1 at the first unit of every slot that was written
    double* grad_background;  // [tiles, 3] gradient, may be null
};

// Number of floats of scratch memory, aligned to 64 bytes, that a tile needs for its extras.
inline int64_t scratch_floats(int extras) { return int64_t(extras) * (kTile * kTile + 16) + 16; }

constexpr int kMostAttributed = 8;

struct Kernels {
    const char* name;
    void (*forward)(const ForwardJob&, int tile, float* scratch);
    void (*backward)(const BackwardJob&, int tile, float* scratch);
    void (*attribute)(const BackwardJob&, int tile, float* scratch);  // of at most kMostAttributed extras; the slots begin with the sums
};

const Kernels& kernels();  // the best ones for this processor
bool select_kernels(const char* name);  // for tests; false if the processor does not support them

}  // namespace e4dgs
