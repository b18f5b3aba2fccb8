// Adam on all tensors of a model at once, on the rows that got a gradient, and only if every gradient is finite. A row whose gradient is all
// zero keeps its value and its moments, and only its gradient is read.
#include "device.cuh"

namespace e4dgs {

constexpr int kAdamThreads = 256;
constexpr int kEach = 4;                       // numbers per thread
constexpr int kChunk = kAdamThreads * kEach;   // most numbers per block

// One tensor [rows, width], as adam.py packs it. Its blocks take `rows_each` whole rows; a row wider than kChunk is divided into `parts`.
struct Entry {
    float* parameter;  // null: the gradient is only checked
    const float* gradient;
    float *first, *second;
    const float* pace;  // [rows], a factor on the rate of each row; null: 1
    int64 rows, width;
    int first_block, parts, rows_each;
    uint32 divide;              // 2^31 / width, rounded up
    float rate, inverse_root;   // see Adam
};
static_assert(sizeof(Entry) == 80);

// The numbers of a tensor that a block takes: `n` from `at`, which is in row `row`.
struct Piece {
    int tensor, part;
    int64 row, at;
    int n;
};

// Denormals count, -0 does not, NaN does.
__device__ __forceinline__ bool is_gradient(float g) { return (__float_as_uint(g) & 0x7fffffffu) != 0; }

// inverse_root: 1 / sqrt of the second moment's bias correction; the first moment's correction is included in rate.
struct Adam {
    float rate, beta1, beta2, epsilon, inverse_root;

    __device__ __forceinline__ void step(float g, float& p, float& m, float& v) const {
        m = fmaf(beta1, m, (1.0f - beta1) * g);
        v = fmaf(beta2, v, (1.0f - beta2) * g * g);
        p -= rate * m / fmaf(sqrtf(v), inverse_root, epsilon);
    }
};

// All threads must call this. The tensors' first blocks ascend from 0.
__device__ __forceinline__ Piece piece_of_block(const Entry* tensors, int count) {
    const int block = int(blockIdx.x);
    int begun = 0;  // tensors that begin at this block or before
#pragma unroll 1
    for (int i = 0; i < count; i += kAdamThreads) {
        const int k = i + int(threadIdx.x);
        begun += __syncthreads_count(k < count && tensors[k].first_block <= block);
    }
    const Entry& t = tensors[begun - 1];
    const int local = block - t.first_block, part = local % t.parts;
    const int64 row = int64(local / t.parts) * t.rows_each, from = int64(part) * kChunk;
    const int64 left = (t.rows - row < t.rows_each ? t.rows - row : t.rows_each) * t.width - from;
    return {begun - 1, part, row, row * t.width + from, int(left < kChunk ? left : kChunk)};
}

// Whether any of the bits `from` to `last` (inclusive) is set.
__device__ __forceinline__ bool any_bit(const uint32* bits, uint32 from, uint32 last) {
    uint32 mask = kAllLanes << (from % 32);
    for (uint32 word = from / 32; word < last / 32; ++word, mask = kAllLanes)
        if (bits[word] & mask) return true;
    return (bits[last / 32] & mask & (kAllLanes >> (31 - last % 32))) != 0;
}

}  // namespace e4dgs

using namespace e4dgs;

// found [blocks]: 1 if a block's numbers have a gradient, else 0. bad [1 + count], zero before: 1 if any number is not finite; then, of each tensor.
extern "C" __global__ void __launch_bounds__(kAdamThreads) check_gradients(const Entry* tensors, int count, uint8* found, volatile uint8* bad) {
    const Piece piece = piece_of_block(tensors, count);
    const float* gradient = tensors[piece.tensor].gradient + piece.at;
    bool any = false, finite = true;
#pragma unroll
    for (int j = 0; j < kEach; ++j) {
        const int i = int(threadIdx.x) + j * kAdamThreads;
        const float g = i < piece.n ? gradient[i] : 0.0f;
        any |= is_gradient(g);
        finite &= is_finite(g);
    }
    if (!finite) bad[0] = 1, bad[1 + piece.tensor] = 1;
    const int all = __syncthreads_or(any);
    if (threadIdx.x == 0) found[blockIdx.x] = all != 0;
}

// Uses the same blocks as check_gradients, and runs after it.
extern "C" __global__ void __launch_bounds__(kAdamThreads)
    adam_rows(const Entry* tensors, int count, const uint8* found, const uint8* bad, float beta1, float beta2, float epsilon) {
    __shared__ uint32 bits[kChunk / 32];  // one for each number, set if it has a gradient
    const int thread = int(threadIdx.x);
    if (bad[0]) return;
    const Piece piece = piece_of_block(tensors, count);
    const Entry& t = tensors[piece.tensor];
    if (!t.parameter) return;
    const uint8* of_row = found + blockIdx.x - piece.part;
    bool any = false;
#pragma unroll 1
    for (int i = thread; i < t.parts; i += kAdamThreads) any |= of_row[i] != 0;
    if (!__syncthreads_or(any)) return;

    const float* gradient = t.gradient + piece.at;
    float g[kEach], p[kEach], m[kEach], v[kEach];
    bool on[kEach];
    uint32 local[kEach] = {};  // row, counted from the block's first
#pragma unroll
    for (int j = 0; j < kEach; ++j) {
        const int i = thread + j * kAdamThreads;
        on[j] = i < piece.n;
        g[j] = on[j] ? gradient[i] : 0.0f;
    }
    if (t.rows_each > 1) {
#pragma unroll
        for (int j = 0; j < kEach; ++j) {
            const uint32 lanes = __ballot_sync(kAllLanes, is_gradient(g[j]));
            if (thread % 32 == 0) bits[(thread + j * kAdamThreads) / 32] = lanes;
        }
        __syncthreads();
        const uint32 width = uint32(t.width);
#pragma unroll
        for (int j = 0; j < kEach; ++j) {
            const uint32 i = uint32(thread + j * kAdamThreads);
            local[j] = __umulhi(2 * i, t.divide);  // i / width: exact, as i and width are at most kChunk
            const uint32 begin = local[j] * width;
            on[j] = on[j] && any_bit(bits, begin, begin + width - 1);
        }
    }

    float *parameter = t.parameter + piece.at, *first = t.first + piece.at, *second = t.second + piece.at;
    // Everything is read before anything is written, so that all of a thread's reads are in flight at once.
#pragma unroll
    for (int j = 0; j < kEach; ++j) {
        const int i = thread + j * kAdamThreads;
        p[j] = on[j] ? parameter[i] : 0.0f, m[j] = on[j] ? first[i] : 0.0f, v[j] = on[j] ? second[i] : 0.0f;
    }
#pragma unroll
    for (int j = 0; j < kEach; ++j) {
        if (!on[j]) continue;
        const int i = thread + j * kAdamThreads;
        const Adam adam{t.pace ? t.rate * t.pace[piece.row + local[j]] : t.rate, beta1, beta2, epsilon, t.inverse_root};
        adam.step(g[j], p[j], m[j], v[j]);
        parameter[i] = p[j], first[i] = m[j], second[i] = v[j];
    }
}
