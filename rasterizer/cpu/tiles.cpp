// Distributes the depth-sorted primitives to the tiles that they may touch: count, prefix sums, fill. Contiguous ranges of the
// order are counted and filled separately and placed one after another, so the result is the same for any number of ranges.
#include <algorithm>

#include "parallel.h"
#include "state.h"

namespace e4dgs {
namespace {

constexpr int kAhead = 16;  // prefetch distance: boxes are visited in depth order, which is random in memory

// f(tile) for each tile of primitive `id`, row by row.
template <class F>
inline void for_tiles(const State& state, uint32_t id, F&& f) {
    const TileBox box = state.boxes[id];
    const Span whole{box.x0, box.x1}, *span = box.wide() ? state.spans.data() + state.span_begin[id] : nullptr;
    for (int ty = box.y0; ty < box.y1; ++ty) {
        const Span row = span ? *span++ : whole;
        for (int tx = row.first; tx < row.last; ++tx)
            if (state.drawn(ty, tx)) f(ty * state.tiles_x + tx);
    }
}

}  // namespace

void distribute(State& state, int threads) {
    const uint32_t n_gaussians = uint32_t(state.scene.gaussians.n);
    const int tiles = state.tiles();
    const int64_t n = int64_t(state.order.size());
    // Use more ranges than threads, because near primitives cover the most tiles.
    const int64_t ranges = threads <= 1 ? 1 : std::max<int64_t>(1, std::min<int64_t>(4 * threads, n / 512));
    const auto limit = [&](int64_t r) { return n * r / ranges; };
    Buffer<uint64_t> at(size_t(ranges) * tiles);  // first the counts, then the position of each range's next entry in a tile
    std::fill(at.begin(), at.end(), 0);

    parallel_blocks(ranges, 1, threads, [&](int64_t r, int64_t, int64_t) {
        uint64_t* count = at.data() + r * tiles;
        for (int64_t k = limit(r); k < limit(r + 1); ++k) {
            if (k + kAhead < n) __builtin_prefetch(&state.boxes[state.order[k + kAhead]]);
            for_tiles(state, state.order[k], [&](int tile) { ++count[tile]; });
        }
    });

    state.tile_begin.resize(tiles + 1);
    uint64_t entries = 0;
    for (int t = 0; t < tiles; ++t) {
        state.tile_begin[t] = entries;
        for (int64_t r = 0; r < ranges; ++r) {
            const uint64_t here = at[r * tiles + t];
            at[r * tiles + t] = entries;
            entries += here;
        }
    }
    state.tile_begin[tiles] = entries;
    state.entries.resize(entries);
    state.masks.resize(entries);

    const uint32_t gaussian_units = uint32_t(state.gaussian_units()), convex_units = uint32_t(state.convex_units());
    parallel_blocks(ranges, 1, threads, [&](int64_t r, int64_t, int64_t) {
        uint64_t* next = at.data() + r * tiles;
        for (int64_t k = limit(r); k < limit(r + 1); ++k) {
            if (k + kAhead < n) __builtin_prefetch(&state.boxes[state.order[k + kAhead]]), __builtin_prefetch(&state.slot_begin[state.order[k + kAhead]]);
            const uint32_t id = state.order[k], units = id < n_gaussians ? gaussian_units : convex_units;
            uint32_t slot = state.slot_begin[id];
            for_tiles(state, id, [&](int tile) { state.entries[next[tile]++] = {id, slot}, slot += units; });
        }
    });
}

}  // namespace e4dgs
