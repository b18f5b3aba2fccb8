// Finds which tiles of each row a primitive may touch, and how many in total. Runs in input order, while the record is in the cache.
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <utility>

#include "bounds.h"
#include "parallel.h"
#include "project.h"
#include "state.h"

namespace e4dgs {
namespace {

constexpr int64_t kGrain = 512;

Span span_of_row(const State& state, const ConvexBounds& bounds, const TileBox& box, int ty) {
    const int width = state.scene.camera.width, height = state.scene.camera.height;
    double low, high;
    const double ya = ty * kTile + 0.5, yb = std::min(ya + kTile - 1, height - 0.5);
    if (!bounds.x_range(ya, yb, low, high)) return {0, 0};
    low = std::max(low, 0.5), high = std::min(high, width - 0.5);
    if (!(low <= high)) return {0, 0};  // checked before converting to integers, because the range may lie far outside
    const int a = std::max(first_tile(low), int(box.x0)), b = std::min(last_tile(high) + 1, int(box.x1));
    if (a >= b) return {0, 0};
    return {uint16_t(a), uint16_t(b)};
}

// The spans of primitives first..last whose boxes are wide in both directions. span_begin is relative to this block's first row.
void block_spans(State& state, int64_t first, int64_t last, std::vector<Span>& spans) {
    const int64_t n = state.scene.gaussians.n;
    uint32_t wide[kGrain], rows = 0;
    int64_t count = 0, gaussians = 0;
    for (int64_t id = first; id < last; ++id) {
        state.span_begin[id] = rows;
        if (std::isnan(state.depth[id]) || !state.boxes[id].wide()) continue;
        rows += uint32_t(state.boxes[id].y1 - state.boxes[id].y0);
        wide[count++] = uint32_t(id);
        gaussians += id < n;
    }
    spans.resize(rows);
    const SpanJob job{state.gaussians.data(), state.boxes.data(), state.span_begin.data(), spans.data(), state.scene.camera.width, state.scene.camera.height};
    project_kernels().spans(job, wide, gaussians);
    for (int64_t k = gaussians; k < count; ++k) {
        const TileBox& box = state.boxes[wide[k]];
        const ConvexBounds bounds(state.convexes[wide[k] - n]);
        for (int ty = box.y0; ty < box.y1; ++ty) spans[state.span_begin[wide[k]] + uint32_t(ty - box.y0)] = span_of_row(state, bounds, box, ty);
    }
}

uint32_t tiles_of(const State& state, int64_t id, const std::vector<Span>& spans) {
    const TileBox& box = state.boxes[id];
    const Span whole{box.x0, box.x1};
    uint32_t tiles = 0;
    for (int ty = box.y0; ty < box.y1; ++ty) {
        const Span& span = box.wide() ? spans[state.span_begin[id] + uint32_t(ty - box.y0)] : whole;
        if (!state.scene.tiles) tiles += uint32_t(span.last - span.first);
        for (int tx = span.first; state.scene.tiles && tx < span.last; ++tx) tiles += state.drawn(ty, tx);
    }
    return tiles;
}

// Called before the large arrays are allocated: those of (tile, primitive) pairs and, with gradients, of their slots.
void refuse_what_cannot_fit(const State& state, uint64_t units, uint64_t rows, bool keep) {
    const uint64_t least = uint64_t(std::min(state.gaussian_units(), state.convex_units())), pairs = units / least;
    const uint64_t bytes = pairs * (sizeof(Entry) + sizeof(uint16_t)) + rows * sizeof(Span) + (keep ? units * (16 + 1) : 0);
    const uint64_t free = free_memory();
    if (units <= 0xffffffffull && rows <= 0xffffffffull && bytes <= free) return;
    char text[512];
    std::snprintf(text, sizeof(text),
                  "%zu primitives cover about %.3g pairs of a tile and a primitive in this %d x %d image, which take %.1f GiB%s; %.1f GiB of memory "
                  "are free, and 4.3e9 pieces of 16 bytes are the most. Render fewer or smaller primitives, or a smaller image",
                  state.depth.size(), double(pairs), state.scene.camera.width, state.scene.camera.height, double(bytes) / (1ull << 30),
                  keep ? " with gradients" : "", double(free) / (1ull << 30));
    throw TooLarge(text);
}

}  // namespace

void find_spans(State& state, bool keep, int threads) {
    const int64_t total = int64_t(state.depth.size()), blocks = (total + kGrain - 1) / kGrain, n = state.scene.gaussians.n;
    const uint32_t gaussian_units = uint32_t(state.gaussian_units()), convex_units = uint32_t(state.convex_units());
    std::vector<std::vector<Span>> spans(blocks);
    std::vector<uint64_t> units(blocks + 1, 0), rows(blocks + 1, 0);
    state.slot_begin.resize(total + 1);
    state.span_begin.resize(total);
    parallel_blocks(total, kGrain, threads, [&](int64_t first, int64_t last, int64_t block) {
        std::vector<Span> mine;  // local to the block, so that threads do not write to adjacent memory
        uint64_t sum = 0;
        block_spans(state, first, last, mine);
        for (int64_t id = first; id < last; ++id) {
            state.slot_begin[id] = uint32_t(sum);
            if (!std::isnan(state.depth[id])) sum += uint64_t(tiles_of(state, id, mine)) * (id < n ? gaussian_units : convex_units);
        }
        units[block + 1] = sum, rows[block + 1] = mine.size();
        spans[block] = std::move(mine);
    });
    for (int64_t b = 0; b < blocks; ++b) units[b + 1] += units[b], rows[b + 1] += rows[b];
    refuse_what_cannot_fit(state, units[blocks], rows[blocks], keep);
    state.spans.resize(rows[blocks]);
    parallel_blocks(total, kGrain, threads, [&](int64_t first, int64_t last, int64_t block) {
        for (int64_t id = first; id < last; ++id) state.slot_begin[id] += uint32_t(units[block]), state.span_begin[id] += uint32_t(rows[block]);
        std::copy(spans[block].begin(), spans[block].end(), state.spans.data() + rows[block]);
    });
    state.slot_begin[total] = uint32_t(units[blocks]);
}

}  // namespace e4dgs
