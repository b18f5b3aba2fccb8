// From projected primitives to each tile's list: counts the tiles that a primitive may touch, writes its (tile, primitive) pairs in depth
// order and, after a stable sort by tile, finds where each tile's pairs begin. Features: POINTS, KEY_BITS (16: fewer than 2^15 tiles, half
// the passes of the sort).
#include "records.cuh"
#include "scan.cuh"

#if !defined(KEY_BITS)
#define KEY_BITS 32
#endif

namespace e4dgs {

#if KEY_BITS == 16
using Key = short;
#else
using Key = int;
#endif

constexpr int kCountThreads = 256;  // COUNT_THREADS in forward.py

// The tiles of one row that a support covers; last is exclusive.
struct Span {
    int first, last;
};

// low, high: px from the left edge of tile `from`, at most box.x0.
template <class T>
__device__ inline Span span_between(T low, T high, int from, const TileBox& box, int width) {
    low = larger(low, T(0.5) - T(from * kTile)), high = smaller(high, T(width - from * kTile) - T(0.5));
    if (!(low <= high)) return {0, 0};  // checked before converting to integers, because the range may lie far outside
    const int a = from + int(ceil((low - T(kTile - 0.5)) / T(kTile))), b = from + int(floor((high - T(0.5)) / T(kTile))) + 1;
    return {a > box.x0 ? a : box.x0, b < box.x1 ? b : box.x1};
}

// The range of x that the ellipse u^2 + v^2 <= radius^2 covers within a row's pixel centres. In float, since consumer GPUs compute double
// at 1/64 of the rate: px from the corner of the box, and wider by `loose`, which is many times what rounding takes away. Where numbers
// overflow, `loose` is infinite or a limit is NaN, and the row is covered whole.
struct GaussianBounds {
    float x, y, f1, f2, inverse, radius2, high_y, rightmost, loose;

    __device__ GaussianBounds(const GaussianRecord& r, const TileBox& box) {
        x = float(r.x - box.x0 * kTile), y = float(r.y - box.y0 * kTile);
        f1 = float(r.f[1]), f2 = float(r.f[2]), inverse = 1.0f / float(r.f[0]);
        radius2 = r.radius * r.radius, high_y = r.radius / f2;
        rightmost = -high_y * f1 / sqrtf(f1 * f1 + f2 * f2);  // y of the ellipse's right end, relative to the centre
        loose = 1e-3f + 1e-6f * (fabsf(x) + (r.radius + fabsf(f1) * (high_y + kTile)) * inverse);
    }
    __device__ float half(float dy) const {
        const float v = f2 * dy;
        return sqrtf(larger(radius2 - v * v, 0.0f));
    }
    __device__ Span span(int row, const TileBox& box, int width, int height) const {
        const float top = float((row - box.y0) * kTile) + 0.5f, bottom = smaller(top + float(kTile - 1), float(height - box.y0 * kTile) - 0.5f);
        const float a = larger(top - y, -high_y), b = smaller(bottom - y, high_y);
        if (!(a <= b)) return {0, 0};
        const float right = larger(smaller(rightmost, b), a), left = larger(smaller(-rightmost, b), a);
        const float low = x + (-half(left) - f1 * left) * inverse - loose, high = x + (half(right) - f1 * right) * inverse + loose;
        return span_between(low, high, box.x0, box, width);
    }
};

#if POINTS
// The polygon in which L_i <= limit for every edge. The range is slightly too large if a corner lies between the rows.
struct ConvexBounds {
    const ConvexRecord& r;

    __device__ explicit ConvexBounds(const ConvexRecord& record) : r(record) {}
    __device__ Span span(int row, const TileBox& box, int width, int height) const {
        constexpr double loose = 1e-6;  // px
        const double top = row * kTile + 0.5, bottom = smaller(top + (kTile - 1), height - 0.5);
        double low = -1e300, high = 1e300;
        for (int i = 0; i < r.n; ++i) {
            const double A = r.line[i][0];
            if (A == 0.0) continue;
            const double inverse = 1.0 / A, slope = -r.line[i][1] * inverse, at = r.x0 + (r.limit - r.line[i][2]) * inverse - slope * r.y0;
            const double a = at + slope * top, b = at + slope * bottom;
            if (A > 0.0)
                high = smaller(high, larger(a, b));
            else
                low = larger(low, smaller(a, b));
        }
        return span_between(low - loose, high + loose, 0, box, width);
    }
};
#endif

// Calls f(row, span) for each row of tiles whose span is not empty.
template <class Bounds, class F>
__device__ inline void for_rows(const Bounds& bounds, const TileBox& box, int width, int height, F&& f) {
    for (int row = box.y0; row < box.y1; ++row) {
        const Span span = bounds.span(row, box, width, height);
        if (span.first < span.last) f(row, span);
    }
}

// Returns the number of tiles of the primitive that are drawn (drawn [tiles]: 0 where nothing is; null: everything is). If `tiles` [room] is given, writes them there as row * tiles_x + column. The same function
// counts and writes and is never inlined: compiled twice, it could round differently and write other tiles than it counted.
__device__ __noinline__ int tiles_of(const GaussianRecord* gaussians, const ConvexRecord* convexes, int n_gaussians, int id, TileBox box, int width,
                                     int height, const unsigned char* drawn, Key* tiles, int room) {
    const int tiles_x = (width + kTile - 1) / kTile;
    int count = 0;
    const auto take = [&](int row, Span span) {
        for (int x = span.first; x < span.last; ++x) {
            if (drawn && !drawn[row * tiles_x + x]) continue;
            if (tiles && count < room) tiles[count] = Key(row * tiles_x + x);
            ++count;
        }
    };
    if (box.x1 - box.x0 <= 1 || box.y1 - box.y0 <= 1) {  // a closer look gains nothing
        for (int row = box.y0; row < box.y1; ++row) take(row, Span{box.x0, box.x1});
    } else if (id < n_gaussians) {
        for_rows(GaussianBounds(gaussians[id], box), box, width, height, take);
    } else {
#if POINTS
        for_rows(ConvexBounds(convexes[id - n_gaussians]), box, width, height, take);
#endif
    }
    return count;
}

}  // namespace e4dgs

using namespace e4dgs;

// counts: see `Count`. order [kept]: primitives from front to back. ends [kept]: inclusive running sums of how many tiles each of them may
// touch. workspace [1 + blocks] is zero at first.
extern "C" __global__ void __launch_bounds__(kCountThreads, 4)
    count_tiles(int64* counts, const GaussianRecord* gaussians, const ConvexRecord* convexes, const TileBox* boxes, int width, int height,
                const unsigned char* drawn, const int* order, int64* ends, uint64* workspace) {
    __shared__ int64 number, shared[kCountThreads / 32 + 2];
    const int64 block = take_number(workspace, &number), rank = block * kCountThreads + threadIdx.x, n = counts[kKept];
    int64 count = 0;
    if (rank < n) {
        const int id = order[rank];
        count = tiles_of(gaussians, convexes, int(counts[kKeptGaussians]), id, boxes[id], width, height, drawn, nullptr, 0);
    }
    const int64 before = sum_before_in_grid<kCountThreads>(count, block, workspace + 1, shared);
    if (rank < n) ends[rank] = before + count;
    if (block == gridDim.x - 1 && threadIdx.x == kCountThreads - 1) counts[kPairs] = before + count;
}

// order and ends as in count_tiles. Pairs beyond `room` are left out; if there are fewer, the rest belongs to no tile.
extern "C" __global__ void __launch_bounds__(128, 7)
    write_pairs(const int64* counts, const GaussianRecord* gaussians, const ConvexRecord* convexes, const TileBox* boxes, int width, int height,
                const unsigned char* drawn, const int* order, const int64* ends, int64 room, Key* tiles, int* primitives) {
    const int64 rank = int64(blockIdx.x) * blockDim.x + threadIdx.x, n = counts[kKept];
    const int nowhere = (width + kTile - 1) / kTile * ((height + kTile - 1) / kTile);  // sorts behind all tiles
    for (int64 k = counts[kPairs] + rank; k < room; k += int64(gridDim.x) * blockDim.x) tiles[k] = Key(nowhere), primitives[k] = 0;
    if (rank >= n) return;
    const int64 begin = rank ? ends[rank - 1] : 0, end = ends[rank] < room ? ends[rank] : room;
    if (begin >= end) return;
    const int id = order[rank], count = int(end - begin);
    tiles_of(gaussians, convexes, int(counts[kKeptGaussians]), id, boxes[id], width, height, drawn, tiles + begin, count);
    for (int k = 0; k < count; ++k) primitives[begin + k] = id;
}

// sorted [n]: tiles of all pairs, ascending. Every element of begins [tiles + 1] is written, and touched [n], which may be null, is set to 0.
extern "C" __global__ void __launch_bounds__(256) find_tiles(int64 n, const Key* sorted, int tiles, int* begins, uint8* touched) {
    const int64 i = int64(blockIdx.x) * blockDim.x + threadIdx.x;
    if (i > n) return;
    if (touched && i < n) touched[i] = 0;
    const int from = i ? sorted[i - 1] + 1 : 0, to = i < n ? sorted[i] : tiles;
    for (int tile = from; tile <= to; ++tile) begins[tile] = int(i);
}
