// Hands the depth-sorted primitives out to the tiles that they may touch: count, prefix sums, fill. Contiguous ranges of the
// order are counted and filled separately and put side by side, so the result is the same for any number of ranges.
#include <cmath>
#include <stdexcept>
#include <string>

#include "bounds.h"
#include "parallel.h"
#include "state.h"

namespace e4dgs {
namespace {

struct Span {
    uint16_t first, last;  // tiles of one row, last excluded
};

constexpr int kAhead = 16;  // boxes and records are visited in order of depth, which is no order in memory

// Inlined by force: the compiler takes a function that only prefetches for one without effect, and drops its calls.
__attribute__((always_inline)) inline void prefetch(const State& state, uint32_t id) {
    const size_t n = state.gaussians.size();
    if (id < n) return __builtin_prefetch(&state.gaussians[id]);
    const char* record = reinterpret_cast<const char*>(&state.convexes[id - n]);
    for (size_t at = 0; at < sizeof(ConvexRecord); at += 64) __builtin_prefetch(record + at);
}

template <class Bounds>
Span span_of_row(const State& state, const Bounds& bounds, int ty) {
    const int width = state.scene.camera.width, height = state.scene.camera.height;
    double low, high;
    const double ya = ty * kTile + 0.5, yb = std::min(ya + kTile - 1, height - 0.5);
    if (!bounds.x_range(ya, yb, low, high)) return {0, 0};
    low = std::max(low, 0.5), high = std::min(high, width - 0.5);
    if (!(low <= high)) return {0, 0};  // before anything becomes an integer: it may lie far outside
    const int a = first_tile(low), b = last_tile(high) + 1;
    if (a >= b) return {0, 0};
    return {uint16_t(a), uint16_t(b)};
}

// Spans of the box's rows, appended; where the box is wide in both directions, no longer than the support needs.
void find_spans(const State& state, uint32_t id, const TileBox& box, std::vector<Span>& spans) {
    const uint32_t n = uint32_t(state.gaussians.size());
    const auto each_row = [&](const auto& bounds) {
        for (int ty = box.y0; ty < box.y1; ++ty) spans.push_back(span_of_row(state, bounds, ty));
    };
    if (id < n)
        each_row(GaussianBounds(state.gaussians[id]));
    else
        each_row(ConvexBounds(state.convexes[id - n], state.scene.camera.width, state.scene.camera.height));
}

// What pass two needs again of the primitives of one range of the order.
struct Range {
    std::vector<Span> spans;  // of wide primitives
};

// f(row, first, last) for each row of tiles of primitive `id`; `span` moves on over the wide ones' spans.
template <class F>
inline void for_rows(const TileBox& box, const Span*& span, F&& f) {
    if (!box.wide()) {
        for (int ty = box.y0; ty < box.y1; ++ty) f(ty, box.x0, box.x1);
        return;
    }
    for (int ty = box.y0; ty < box.y1; ++ty, ++span) f(ty, span->first, span->last);
}

}  // namespace

void distribute(State& state, int threads) {
    const uint32_t n_gaussians = uint32_t(state.scene.gaussians.n);
    const int tiles = state.tiles();
    const int64_t n = int64_t(state.order.size());
    const int64_t ranges = std::max<int64_t>(1, std::min<int64_t>(threads, n / 512));
    const auto limit = [&](int64_t r) { return n * r / ranges; };
    std::vector<Range> parts(ranges);
    Buffer<uint64_t> at(size_t(ranges) * tiles);  // first counts, then where each range's next entry of a tile goes
    std::fill(at.begin(), at.end(), 0);
    const size_t total = state.depth.size();
    const uint32_t gaussian_units = uint32_t(state.gaussian_units()), convex_units = uint32_t(state.convex_units());
    state.slot_begin.resize(total + 1);
    std::fill(state.slot_begin.begin(), state.slot_begin.end(), 0u);

    parallel_blocks(ranges, 1, threads, [&](int64_t r, int64_t, int64_t) {
        Range& part = parts[r];
        uint64_t* count = at.data() + r * tiles;
        for (int64_t k = limit(r); k < limit(r + 1); ++k) {
            if (k + 2 * kAhead < n) __builtin_prefetch(&state.boxes[state.order[k + 2 * kAhead]]);
            if (k + kAhead < n && state.boxes[state.order[k + kAhead]].wide()) prefetch(state, state.order[k + kAhead]);
            const uint32_t id = state.order[k];
            const TileBox box = state.boxes[id];
            const size_t first_span = part.spans.size();
            if (box.wide()) find_spans(state, id, box, part.spans);
            const Span* span = part.spans.data() + first_span;
            uint32_t found = 0;
            for_rows(box, span, [&](int ty, int first, int last) {
                found += uint32_t(last - first);
                for (int tx = first; tx < last; ++tx) ++count[ty * state.tiles_x + tx];
            });
            state.slot_begin[id] = found * (id < n_gaussians ? gaussian_units : convex_units);
        }
    });

    state.tile_begin.resize(tiles + 1);
    uint64_t entries = 0, units = 0;
    for (int t = 0; t < tiles; ++t) {
        state.tile_begin[t] = entries;
        for (int64_t r = 0; r < ranges; ++r) {
            const uint64_t here = at[r * tiles + t];
            at[r * tiles + t] = entries;
            entries += here;
        }
    }
    state.tile_begin[tiles] = entries;
    for (size_t id = 0; id <= total; ++id) {
        const uint32_t here = state.slot_begin[id];
        state.slot_begin[id] = uint32_t(units);
        units += here;
    }
    if (units > 0xffffffffull)
        throw std::runtime_error("the primitives cover too many tiles (" + std::to_string(entries) + " pairs); render fewer or a smaller image");
    state.entries.resize(entries);
    state.masks.resize(entries);

    parallel_blocks(ranges, 1, threads, [&](int64_t r, int64_t, int64_t) {
        uint64_t* next = at.data() + r * tiles;
        const Span* span = parts[r].spans.data();
        for (int64_t k = limit(r); k < limit(r + 1); ++k) {
            if (k + kAhead < n) __builtin_prefetch(&state.boxes[state.order[k + kAhead]]), __builtin_prefetch(&state.slot_begin[state.order[k + kAhead]]);
            const uint32_t id = state.order[k];
            const uint32_t units_each = id < n_gaussians ? gaussian_units : convex_units;
            uint32_t slot = state.slot_begin[id];
            for_rows(state.boxes[id], span, [&](int ty, int first, int last) {
                for (int tx = first; tx < last; ++tx, slot += units_each) state.entries[next[ty * state.tiles_x + tx]++] = {id, slot};
            });
        }
    });
}

}  // namespace e4dgs
