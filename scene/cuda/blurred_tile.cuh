// A tile of an image and its margin, blurred by the window of SSIM: columns, from global into shared memory, then rows.
#pragma once
#include "window.cuh"

namespace e4dgs {

constexpr int kWide = 32, kHigh = 8;             // px, size of a tile
constexpr int kCols = kWide + 2 * kRadius;       // px, including the margin for the window
constexpr int kRows = kHigh + 2 * kRadius;
constexpr int kPitch = 44;                       // row stride in floats in shared memory: allows float4 reads and avoids bank conflicts
constexpr int kRun = 4;                          // px per thread, a float4
constexpr int kLossThreads = kWide * kHigh * 3 / kRun;

using Plane = float[kHigh][3][kPitch];  // one tile in shared memory: row, channel, column

struct Tile {
    int x0, y0;     // its first pixel
    bool opposite;  // of the background: its tiles follow those of the first

    __device__ __forceinline__ Tile(int width, int height) {
        const int across = (width + kWide - 1) / kWide, down = (height + kHigh - 1) / kHigh, row = int(blockIdx.x) / across;
        x0 = int(blockIdx.x) % across * kWide, y0 = row % down * kHigh, opposite = row >= down;
    }
};

// in [kRows]: a column of `map` with row stride `step`, starting kRadius rows above the tile. Zero outside the image.
__device__ __forceinline__ void read_column(const float* map, int64 step, int y0, int height, bool inside, float* in) {
    const uint32 rows = inside ? uint32(height) : 0;  // as unsigned numbers, rows above the image are very large
    map += (y0 - kRadius) * step;
#pragma unroll
    for (int r = 0; r < kRows; ++r, map += step) in[r] = uint32(y0 - kRadius + r) < rows ? *map : 0.0f;
}

// in(0) ... in(kRows - 1) are the numbers of a column.
template <class F>
__device__ __forceinline__ void blur_column(F&& in, Plane& to, int channel, int column) {
    float out[kHigh];
    blur<kHigh>(in, out);
#pragma unroll
    for (int r = 0; r < kHigh; ++r) to[r][channel][column] = out[r];
}

// out [kRun], starting at pixel `x` of the tile.
__device__ __forceinline__ void blur_row(const float* row, int x, float* out) {
    float in[kRun + 12];  // kRun + 2 kRadius are needed
#pragma unroll
    for (int q = 0; q < 4; ++q) {
        const float4 four = *reinterpret_cast<const float4*>(row + x + 4 * q);
        in[4 * q] = four.x, in[4 * q + 1] = four.y, in[4 * q + 2] = four.z, in[4 * q + 3] = four.w;
    }
    blur<kRun>([&](int i) { return in[i]; }, out);
}

__device__ __forceinline__ void store_run(float* to, const float* run) {
    *reinterpret_cast<float4*>(to) = make_float4(run[0], run[1], run[2], run[3]);
}

}  // namespace e4dgs
