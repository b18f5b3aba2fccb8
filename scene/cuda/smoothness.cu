// The smoothness of feature planes: mean squared differences of neighbours, and their gradient. A stack of planes is [3, rows, columns, channels]. A
// block takes a piece of kPiece numbers of one row; `row` = columns * channels. Space planes use first differences along both axes. Time planes, whose
// rows are times, use second differences from row to row.
#include "warp_sum.cuh"

namespace e4dgs {

constexpr int kPiece = 256;  // threads of a block

struct Spot {
    int64 at;  // index in the stack
    int r, k;  // row in the plane, and index in the row
};

__device__ __forceinline__ Spot spot_of(int rows, int row) {
    const int pieces = (row + kPiece - 1) / kPiece, line = int(blockIdx.x) / pieces, k = int(blockIdx.x) % pieces * kPiece + int(threadIdx.x);
    return {int64(line) * row + k, line % rows, k};
}

// v[at] - 2 v[at + row] + v[at + 2 row]
__device__ __forceinline__ float bend(const float* v, int row) { return v[0] - 2.0f * v[row] + v[2 * int64(row)]; }

}  // namespace e4dgs

using namespace e4dgs;

// parts [blocks]: the squared differences that start in a block's piece, weighted by along_row and along_column and summed.
extern "C" __global__ void __launch_bounds__(kPiece)
    smoothness_value(const float* values, int rows, int row, int channels, bool second, float along_row, float along_column, float* parts) {
    __shared__ float warps[kPiece / 32];
    const Spot spot = spot_of(rows, row);
    float sum = 0.0f;
    if (spot.k < row) {
        const float* v = values + spot.at;
        if (spot.k + channels < row) {
            const float d = v[channels] - v[0];
            sum = along_row * d * d;
        }
        if (spot.r + (second ? 2 : 1) < rows) {
            const float d = second ? bend(v, row) : v[row] - v[0];
            sum = fmaf(along_column * d, d, sum);
        }
    }
    sum = warp_totals<1>(&sum, int(threadIdx.x) % 32);
    if (threadIdx.x % 32 == 0) warps[threadIdx.x / 32] = sum;
    __syncthreads();
    if (threadIdx.x) return;
    for (int w = 1; w < kPiece / 32; ++w) sum += warps[w];
    parts[blockIdx.x] = sum;
}

// gradient, shaped like values: upstream [1] times the gradient of the sum of all parts.
extern "C" __global__ void __launch_bounds__(kPiece) smoothness_gradient(const float* values, int rows, int row, int channels, bool second, float along_row,
                                                                         float along_column, const float* upstream, float* gradient) {
    const Spot spot = spot_of(rows, row);
    if (spot.k >= row) return;
    const float *v = values + spot.at, here = v[0];
    float across = 0.0f, down = 0.0f;
    if (spot.k >= channels) across += here - v[-channels];
    if (spot.k + channels < row) across -= v[channels] - here;
    if (second) {
        if (spot.r + 2 < rows) down += bend(v, row);
        if (spot.r >= 1 && spot.r + 1 < rows) down -= 2.0f * bend(v - row, row);
        if (spot.r >= 2) down += bend(v - 2 * int64(row), row);
    } else {
        if (spot.r >= 1) down += here - v[-row];
        if (spot.r + 1 < rows) down -= v[row] - here;
    }
    gradient[spot.at] = 2.0f * upstream[0] * fmaf(along_row, across, along_column * down);
}
