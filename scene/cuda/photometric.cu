// The image terms, l1 mean|x - y| + ssim (1 - SSIM), and their gradients, with x and y from `Pictures`. A block does one tile: it blurs columns,
// one per thread, from global into shared memory, where the pixels of a channel are adjacent, and then rows, four pixels per thread.
#include "block_sums.cuh"
#include "blurred_tile.cuh"
#include "pictures.cuh"

namespace e4dgs {

constexpr int kLossBlocks = 6;                             // resident per multiprocessor: as many as registers allow without spills
constexpr float kC1 = 0.01f * 0.01f, kC2 = 0.03f * 0.03f;  // for values in [0, 1]

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

}  // namespace e4dgs

using namespace e4dgs;

// Before `maps` come the members of `Pictures`, sizes, and the weights of the terms: l1 and ssim, per number of an image, on the background that
// was rendered; l1_opposite and ssim_opposite on the other one; of_alpha, per pixel, of |alpha - known|.
// maps [1 or 2 backgrounds, 3, 3, height, pitch]: the derivatives of SSIM with respect to the windowed means of x, x^2 and x y, a plane for each
// channel; or null. pitch is a multiple of 4; the padding of a row is unused. losses [blocks]: each tile's part of the loss.
extern "C" __global__ void __launch_bounds__(kLossThreads, kLossBlocks)
    photometric_loss(const float* image, const float* target, const float* weight, const float* gain, const float* offset, const float* alpha,
                     const float* known, const bool* kept, float red, float green, float blue, int width, int height, int pitch,
                     float l1, float ssim, float l1_opposite, float ssim_opposite, float of_alpha, float* maps, float* losses) {
    __shared__ alignas(16) Plane means[4];  // of x, y, x^2 + y^2, x y
    const Pictures pictures{image, target, weight, gain, offset, alpha, known, kept, red, green, blue};
    const Tile tile(width, height);
    const int thread = int(threadIdx.x);
    float loss = 0.0f;
    if (thread < 3 * kCols) {  // coalesced reads: neighbouring threads read neighbouring numbers
        const int column = thread / 3, channel = thread % 3, px = tile.x0 - kRadius + column, top = tile.y0 - kRadius;
        const int64 first = int64(top) * width + px;
        const uint32 rows = px >= 0 && px < width ? uint32(height) : 0;  // as unsigned numbers, rows above the image are very large
        float x[kRows], y[kRows];
#pragma unroll
        for (int r = 0; r < kRows; ++r) {
            x[r] = y[r] = 0.0f;
            if (uint32(top + r) >= rows) continue;
            const Pair pair = pictures.pair(first + r * width, channel, tile.opposite);
            x[r] = pair.x, y[r] = pair.y;
        }
        if (column >= kRadius && column < kRadius + kWide) {
            float sum = 0.0f;
#pragma unroll
            for (int r = kRadius; r < kRadius + kHigh; ++r) sum += fabsf(x[r] - y[r]);  // both are 0 outside
            loss = (tile.opposite ? l1_opposite : l1) * sum;
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
        loss = fmaf(tile.opposite ? ssim_opposite : ssim, sum, loss);
        const int plane = tile.opposite ? 9 : 0;
#pragma unroll
        for (int m = 0; m < 3 && maps; ++m) store_run(maps + (int64(plane + 3 * m + channel) * height + py) * pitch + px, d[m]);
    }
    for (int i = thread; i < kWide * kHigh && tile.opposite; i += kLossThreads) {
        const int x = tile.x0 + i % kWide, y = tile.y0 + i / kWide;
        if (x < width && y < height) loss = fmaf(of_alpha, fabsf(pictures.excess(int64(y) * width + x)), loss);
    }
    block_sums<kLossThreads, 1>(&loss, losses + blockIdx.x);
}

// upstream [1] times the loss's gradients: d_image [height, width, 3] and d_alpha [height, width], written in full, and each tile's part of
// those by gain and offset, d_recording [blocks, 6]. The last two are null as alpha and gain are.
extern "C" __global__ void __launch_bounds__(kLossThreads, kLossBlocks)
    photometric_gradient(const float* image, const float* target, const float* weight, const float* gain, const float* offset, const float* alpha,
                         const float* known, const bool* kept, float red, float green, float blue, int width, int height, int pitch,
                         float l1, float ssim, float l1_opposite, float ssim_opposite, float of_alpha, const float* maps, const float* upstream,
                         float* d_image, float* d_alpha, float* d_recording) {
    __shared__ alignas(16) Plane planes[3];
    const Pictures pictures{image, target, weight, gain, offset, alpha, known, kept, red, green, blue};
    const Tile tile(width, height);
    const int thread = int(threadIdx.x);
    const float scale = *upstream;
    constexpr int across = 3 * kWide, each = kHigh * across / kLossThreads;  // numbers per thread, all in one column
    static_assert(kLossThreads % across == 0 && kHigh * across % kLossThreads == 0);
    const int c = thread % 3, column = thread % across / 3, to = tile.x0 + column;
    float by_gain = 0.0f, by_offset = 0.0f;
    for (int background = 0; background < (alpha ? 2 : 1); ++background) {
        for (int i = thread; i < 9 * kCols; i += kLossThreads) {
            const int from = i % kCols, channel = i / kCols % 3, map = i / (3 * kCols), px = tile.x0 - kRadius + from;
            float in[kRows];
            const float* plane = maps + int64(9 * background + 3 * map + channel) * height * pitch;
            read_column(plane + px, pitch, tile.y0, height, px >= 0 && px < width, in);
            blur_column([&](int r) { return in[r]; }, planes[map], channel, from);
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
#pragma unroll 1  // more numbers at once would take more registers than there are
        for (int j = 0; j < each; ++j) {
            const int r = thread / across + j * (kHigh / each), y = tile.y0 + r;
            if (to >= width || y >= height) continue;
            const Pair pair = pictures.pair(int64(y) * width + to, c, background);
            const float similar = planes[0][r][c][column] + 2.0f * pair.x * planes[1][r][c][column] + pair.y * planes[2][r][c][column];
            const float by_l1 = (background ? l1_opposite : l1) * sign_of(pair.x - pair.y);
            const float by_ssim = (background ? ssim_opposite : ssim) * similar;
            const float by_recorded = scale * pair.weight * (by_l1 - by_ssim), by_raw = gain ? gain[c] * by_recorded : by_recorded;
            by_gain = fmaf(by_recorded, pair.raw, by_gain), by_offset += by_recorded;
            float& out = d_image[3 * (int64(y) * width + to) + c];
            out = background ? out + by_raw : by_raw;
            if (background) planes[0][r][c][column] = -pictures.change(c) * by_raw;  // of alpha, by this channel
        }
        __syncthreads();  // before the planes are overwritten, and for the sum over the channels
    }
    for (int i = thread; i < kWide * kHigh && alpha; i += kLossThreads) {
        const int x = i % kWide, r = i / kWide, px = tile.x0 + x, py = tile.y0 + r;
        if (px >= width || py >= height) continue;
        const int64 pixel = int64(py) * width + px;
        const float by_color = planes[0][r][0][x] + planes[0][r][1][x] + planes[0][r][2][x];
        d_alpha[pixel] = fmaf(scale * of_alpha * pictures.weight_of(pixel), sign_of(pictures.excess(pixel)), by_color);
    }
    if (!gain) return;
    float sums[6];
#pragma unroll
    for (int k = 0; k < 3; ++k) sums[k] = c == k ? by_gain : 0.0f, sums[3 + k] = c == k ? by_offset : 0.0f;
    block_sums<kLossThreads, 6>(sums, d_recording + 6 * int64(blockIdx.x));
}
