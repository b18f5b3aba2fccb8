// The image terms, l1 mean|x - y| + ssim (1 - SSIM), and their gradient with respect to x. Images are [H, W, 3]. A block does one tile: it blurs
// columns, one per thread, from global into shared memory, where the pixels of a channel are adjacent, and then rows, four pixels per thread.
#include "warp_sum.cuh"
#include "window.cuh"

namespace e4dgs {

constexpr int kWide = 32, kHigh = 8;             // px, size of a tile
constexpr int kCols = kWide + 2 * kRadius;       // px, including the margin for the window
constexpr int kRows = kHigh + 2 * kRadius;
constexpr int kPitch = 44;                       // row stride in floats in shared memory: allows float4 reads and avoids bank conflicts
constexpr int kRun = 4;                          // px per thread, a float4
constexpr int kLossThreads = kWide * kHigh * 3 / kRun;
constexpr int kLossBlocks = 6;                   // resident per multiprocessor: as many as registers allow without spills
constexpr float kC1 = 0.01f * 0.01f, kC2 = 0.03f * 0.03f;  // for values in [0, 1]

using Plane = float[kHigh][3][kPitch];  // one tile in shared memory: row, channel, column

struct Tile {
    int x0, y0;  // its first pixel

    __device__ __forceinline__ explicit Tile(int width) {
        const int across = (width + kWide - 1) / kWide;
        x0 = int(blockIdx.x) % across * kWide, y0 = int(blockIdx.x) / across * kHigh;
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

// From the windowed means of x, y, x^2 + y^2 (SSIM needs only the sum of the variances) and x y: 1 - SSIM, and the derivatives of SSIM with respect
// to the means of x, x^2 and x y.
__device__ __forceinline__ float dissimilarity(float mx, float my, float squares, float xy, float& d_mx, float& d_xx, float& d_xy) {
    const float product = mx * my, sum = mx * mx + my * my;
    const float a = 2.0f * product + kC1, b = 2.0f * (xy - product) + kC2, c = sum + kC1, d = squares - sum + kC2;
    const float inverse = reciprocal(c * d), s = a * b * inverse;
    d_xx = -s * c * inverse, d_xy = 2.0f * a * inverse;
    d_mx = 2.0f * (my * b * inverse - mx * (s * d * inverse + d_xx)) - my * d_xy;
    return 1.0f - s;
}

// The sum over the block; valid in thread 0.
__device__ __forceinline__ float block_sum(float value) {
    __shared__ float warps[kLossThreads / 32];
    const int thread = int(threadIdx.x);
    const float total = warp_totals<1>(&value, thread % 32);
    if (thread % 32 == 0) warps[thread / 32] = total;
    __syncthreads();
    float sum = 0.0f;
    for (int w = 0; w < kLossThreads / 32; ++w) sum += warps[w];
    return sum;
}

}  // namespace e4dgs

using namespace e4dgs;

// losses [blocks]: each tile's part of the loss. l1 and ssim: weights per number of the image. maps [3, 3, height, pitch]: the derivatives of SSIM
// with respect to the windowed means of x, x^2 and x y, a plane for each channel; or null. pitch is a multiple of 4; the padding of a row is unused.
extern "C" __global__ void __launch_bounds__(kLossThreads, kLossBlocks)
    photometric_loss(const float* image, const float* target, int width, int height, int pitch, float l1, float ssim, float* maps, float* losses) {
    __shared__ alignas(16) Plane means[4];  // of x, y, x^2 + y^2, x y
    const Tile tile(width);
    const int thread = int(threadIdx.x);
    float loss = 0.0f;
    if (thread < 3 * kCols) {  // coalesced reads: neighbouring threads read neighbouring numbers
        const int column = thread / 3, channel = thread % 3, px = tile.x0 - kRadius + column;
        const bool inside = px >= 0 && px < width;
        const int64 at = 3 * int64(px) + channel, step = 3 * int64(width);
        float x[kRows], y[kRows];
        read_column(image + at, step, tile.y0, height, inside, x);
        read_column(target + at, step, tile.y0, height, inside, y);
        if (column >= kRadius && column < kRadius + kWide) {
            float sum = 0.0f;
#pragma unroll
            for (int r = kRadius; r < kRadius + kHigh; ++r) sum += fabsf(x[r] - y[r]);  // both are 0 outside
            loss = l1 * sum;
        }
        blur_column([&](int r) { return x[r]; }, means[0], channel, column);
        blur_column([&](int r) { return y[r]; }, means[1], channel, column);
        blur_column([&](int r) { return fmaf(x[r], x[r], y[r] * y[r]); }, means[2], channel, column);
        blur_column([&](int r) { return x[r] * y[r]; }, means[3], channel, column);
    }
    __syncthreads();
    const int x = thread % (kWide / kRun) * kRun, channel = thread / (kWide / kRun) % 3, row = thread / (kWide / kRun * 3);
    const int px = tile.x0 + x, py = tile.y0 + row;
    if (px < width && py < height) {
        float mean[4][kRun], d[3][kRun], sum = 0.0f;
#pragma unroll
        for (int m = 0; m < 4; ++m) blur_row(means[m][row][channel], x, mean[m]);
#pragma unroll
        for (int i = 0; i < kRun; ++i) {
            const float lost = dissimilarity(mean[0][i], mean[1][i], mean[2][i], mean[3][i], d[0][i], d[1][i], d[2][i]);
            sum += px + i < width ? lost : 0.0f;
        }
        loss = fmaf(ssim, sum, loss);
#pragma unroll
        for (int m = 0; m < 3 && maps; ++m) store_run(maps + (int64(3 * m + channel) * height + py) * pitch + px, d[m]);
    }
    loss = block_sum(loss);
    if (thread == 0) losses[blockIdx.x] = loss;
}

// gradient [height, width, 3], written in full: upstream [1] times the loss's gradient by the image.
extern "C" __global__ void __launch_bounds__(kLossThreads, kLossBlocks)
    photometric_gradient(const float* image, const float* target, const float* maps, const float* upstream, int width, int height, int pitch, float l1,
                         float ssim, float* gradient) {
    __shared__ alignas(16) Plane planes[3];
    const Tile tile(width);
    const int thread = int(threadIdx.x);
    for (int i = thread; i < 9 * kCols; i += kLossThreads) {
        const int column = i % kCols, channel = i / kCols % 3, map = i / (3 * kCols), px = tile.x0 - kRadius + column;
        float in[kRows];
        read_column(maps + int64(3 * map + channel) * height * pitch + px, pitch, tile.y0, height, px >= 0 && px < width, in);
        blur_column([&](int r) { return in[r]; }, planes[map], channel, column);
    }
    __syncthreads();
    const int x = thread % (kWide / kRun) * kRun, channel = thread / (kWide / kRun) % 3, row = thread / (kWide / kRun * 3);
    float blurred[3][kRun];
#pragma unroll
    for (int m = 0; m < 3; ++m) blur_row(planes[m][row][channel], x, blurred[m]);
    __syncthreads();  // the results overwrite their inputs, so that images can then be read and written in coalesced order
#pragma unroll
    for (int m = 0; m < 3; ++m) store_run(&planes[m][row][channel][x], blurred[m]);
    __syncthreads();
    const float scale = *upstream;
    constexpr int across = 3 * kWide, each = kHigh * across / kLossThreads;  // numbers per thread, all in one column
    static_assert(kLossThreads % across == 0 && kHigh * across % kLossThreads == 0);
    const int c = thread % 3, column = thread % across / 3, to = tile.x0 + column;
#pragma unroll
    for (int j = 0; j < each; ++j) {
        const int r = thread / across + j * (kHigh / each), y = tile.y0 + r;
        if (to >= width || y >= height) continue;
        const int64 at = (int64(y) * width + to) * 3 + c;
        const float a = image[at], b = target[at], sign = a > b ? 1.0f : a < b ? -1.0f : 0.0f;
        const float similar = planes[0][r][c][column] + 2.0f * a * planes[1][r][c][column] + b * planes[2][r][c][column];
        gradient[at] = scale * (l1 * sign - ssim * similar);
    }
}
