// The state of a frame that its forward pass computes and its backward pass needs.
#pragma once
#include <cstdint>
#include <vector>

#include "buffer.h"
#include "records.h"
#include "scene.h"

namespace e4dgs {

// Number of units (of 4 floats) for the gradients of a (tile, primitive) pair: color 3, z 1, shape, extras E, rounded up.
inline int slot_units(int shape, int extras) { return (4 + shape + extras + 3) / 4; }

inline int tiles_across(int pixels) { return (pixels + kTile - 1) / kTile; }

struct State {
    SceneInput scene;
    int tiles_x = 0, tiles_y = 0;
    Buffer<GaussianRecord> gaussians;
    Buffer<ConvexRecord> convexes;
    Buffer<double> depth;         // [N+M], z; NaN if culled or if its box holds no tile
    Buffer<TileBox> boxes;        // [N+M]
    Buffer<uint32_t> span_begin;  // [N+M] for wide boxes: where their rows begin in `spans`
    Buffer<Span> spans;
    Buffer<uint32_t> order;       // primitives that were not culled, front to back
    Buffer<uint32_t> slot_begin;  // [N+M+1], in units of 4 floats
    Buffer<uint64_t> tile_begin;  // [tiles + 1]
    Buffer<Entry> entries;        // by tile, front to back
    Buffer<uint16_t> masks;       // [entries] which blocks of the tile the entry may touch
    Buffer<float> transmittance;  // [H, W] behind the last layer
    Buffer<int32_t> last;         // [H, W] the last entry of its tile that may have been blended, -1 if none

    int tiles() const { return tiles_x * tiles_y; }
    bool drawn(int ty, int tx) const { return !scene.tiles || scene.tiles[ty * tiles_x + tx]; }
    int gaussian_units() const { return slot_units(kGaussianShape, scene.extras); }
    int convex_units() const { return slot_units(convex_shape(scene.convexes.points_each), scene.extras); }
};

void preprocess(State& state, int threads);              // records, depth, boxes
void find_spans(State& state, bool keep, int threads);   // span_begin, spans, slot_begin; throws TooLarge
void sort_by_depth(State& state, int threads);           // order
void distribute(State& state, int threads);              // tile_begin, entries
void blend_forward(State& state, const FrameOutput& out, bool keep, int threads);
void blend_backward(const State& state, const FrameGrad& grad, Buffer<float>& slots, Buffer<uint8_t>& touched, double* background,
                    bool attribution, int threads);  // attribution: of the extras alone
void backward(const State& state, const FrameGrad& grad, const SceneGrad& out, int threads);

}  // namespace e4dgs
