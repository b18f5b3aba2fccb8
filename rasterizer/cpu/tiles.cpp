// Hands the depth-sorted primitives out to the tiles that they may touch: count, prefix sums, fill. Contiguous ranges of the
// order are counted and filled separately and put side by side, so the result is the same for any number of ranges.
#include <cmath>
#include <stdexcept>

#include "bounds.h"
#include "parallel.h"
#include "state.h"

namespace e4dgs {
namespace {

struct Span {
    uint16_t first, last;  // tiles of one row, last excluded
};

struct Rows {
    uint16_t first, last;  // rows of tiles, last excluded
};

struct Range {  // of the order
    std::vector<Rows> rows;
    std::vector<Span> spans;
};

constexpr int kAhead = 12;  // records are visited in order of depth, which is no order in memory

// Inlined by force: the compiler takes a function that only prefetches for one without effect, and drops its calls.
__attribute__((always_inline)) inline void prefetch(const State& state, uint32_t id) {
    const size_t n = state.gaussians.size();
    if (id < n) return __builtin_prefetch(&state.gaussians[id]);
    const char* record = reinterpret_cast<const char*>(&state.convexes[id - n]);
    for (size_t at = 0; at < sizeof(ConvexRecord); at += 64) __builtin_prefetch(record + at);
}

template <class Bounds>
uint32_t find_spans(const State& state, const Bounds& bounds, Range& range) {
    const int width = state.scene.camera.width, height = state.scene.camera.height;
    // Tile t holds the pixel centres kTile t + 0.5 ... kTile t + kTile - 0.5.
    const auto first_tile = [](double low) { return int(std::ceil((low - (kTile - 0.5)) / kTile)); };
    const auto last_tile = [](double high) { return int(std::floor((high - 0.5) / kTile)); };
    const double low_y = std::max(bounds.low_y(), 0.5), high_y = std::min(bounds.high_y(), height - 0.5);
    const double low_x = std::max(bounds.low_x(), 0.5), high_x = std::min(bounds.high_x(), width - 0.5);
    uint32_t tiles = 0;
    Rows rows{0, 0};
    Span box{0, 0};
    if (low_y <= high_y && low_x <= high_x) {
        box = {uint16_t(first_tile(low_x)), uint16_t(last_tile(high_x) + 1)};

        rows.first = uint16_t(std::max(first_tile(low_y), 0));
        rows.last = uint16_t(std::min(last_tile(high_y), state.tiles_y - 1) + 1);
        if (rows.last < rows.first) rows.last = rows.first;
    }
    for (int ty = rows.first; ty < rows.last; ++ty) {
        if (box.last <= box.first + 1) {  // nothing to gain from looking closer
            if (box.last < box.first) box.last = box.first;
            tiles += box.last - box.first;
            range.spans.push_back(box);
            continue;
        }
        double low, high;
        const double ya = ty * kTile + 0.5, yb = std::min(ya + kTile - 1, height - 0.5);
        Span span{0, 0};
        if (bounds.x_range(ya, yb, low, high)) {
            low = std::max(low, 0.5), high = std::min(high, width - 0.5);
            if (low <= high) {  // else far outside, and no number of a tile
                const int a = first_tile(low), b = last_tile(high) + 1;
                if (a < b) span = {uint16_t(a), uint16_t(b)};
            }
        }
        tiles += span.last - span.first;
        range.spans.push_back(span);
    }
    range.rows.push_back(rows);
    return tiles;
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
    state.slot_begin.resize(total + 1);
    std::fill(state.slot_begin.begin(), state.slot_begin.end(), 0u);

    parallel_blocks(ranges, 1, threads, [&](int64_t r, int64_t, int64_t) {
        Range& part = parts[r];
        uint64_t* count = at.data() + r * tiles;
        part.rows.reserve(limit(r + 1) - limit(r));
        for (int64_t k = limit(r); k < limit(r + 1); ++k) {
            if (k + kAhead < n) prefetch(state, state.order[k + kAhead]);
            const uint32_t id = state.order[k];
            const size_t first_span = part.spans.size();
            uint32_t found;
            if (id < n_gaussians)
                found = find_spans(state, GaussianBounds(state.gaussians[id]), part);
            else
                found = find_spans(state, ConvexBounds(state.convexes[id - n_gaussians], state.scene.camera.width, state.scene.camera.height), part);
            state.slot_begin[id] = found * uint32_t(id < n_gaussians ? state.gaussian_units() : state.convex_units());
            const Rows rows = part.rows.back();
            for (int ty = rows.first; ty < rows.last; ++ty) {
                const Span span = part.spans[first_span + ty - rows.first];
                for (int tx = span.first; tx < span.last; ++tx) ++count[ty * state.tiles_x + tx];
            }
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
        const Range& part = parts[r];
        uint64_t* next = at.data() + r * tiles;
        const Span* span = part.spans.data();
        for (int64_t k = limit(r); k < limit(r + 1); ++k) {
            const uint32_t id = state.order[k];
            const uint32_t units_each = uint32_t(id < n_gaussians ? state.gaussian_units() : state.convex_units());
            uint32_t slot = state.slot_begin[id];
            const Rows rows = part.rows[k - limit(r)];
            for (int ty = rows.first; ty < rows.last; ++ty, ++span)
                for (int tx = span->first; tx < span->last; ++tx) {
                    state.entries[next[ty * state.tiles_x + tx]++] = {id, slot};
                    slot += units_each;
                }
        }
    });
}

}  // namespace e4dgs
