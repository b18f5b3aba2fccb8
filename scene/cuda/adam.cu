// Adam on the rows that got a gradient. A row whose gradient is all zero keeps its value and its moments, and only its gradient is read;
// NaN counts as a gradient.
#include "device.cuh"

namespace e4dgs {

constexpr int kAdamThreads = 256;
constexpr int kEach = 4;                       // numbers per thread
constexpr int kChunk = kAdamThreads * kEach;   // numbers per block

// Denormals count, -0 does not.
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

// g [kEach]: a thread's gradients, at indices threadIdx.x + j * kAdamThreads; entries that are not `on` are left alone. Everything is read
// before anything is written, so that all of a thread's reads are in flight at once.
__device__ __forceinline__ void step_chunk(const Adam& adam, const float* g, const bool* on, float* parameter, float* first, float* second) {
    const int thread = int(threadIdx.x);
    float p[kEach], m[kEach], v[kEach];
#pragma unroll
    for (int j = 0; j < kEach; ++j) {
        const int i = thread + j * kAdamThreads;
        p[j] = on[j] ? parameter[i] : 0.0f, m[j] = on[j] ? first[i] : 0.0f, v[j] = on[j] ? second[i] : 0.0f;
    }
#pragma unroll
    for (int j = 0; j < kEach; ++j) {
        if (!on[j]) continue;
        const int i = thread + j * kAdamThreads;
        adam.step(g[j], p[j], m[j], v[j]);
        parameter[i] = p[j], first[i] = m[j], second[i] = v[j];
    }
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

// All tensors are [rows, width], width <= kChunk. A block takes rows_each whole rows, at most kChunk numbers. divide: 2^31 / width, rounded up.
extern "C" __global__ void __launch_bounds__(kAdamThreads)
    adam_narrow(int64 rows, int width, int rows_each, uint32 divide, float* parameter, const float* gradient, float* first, float* second, float rate,
                float beta1, float beta2, float epsilon, float inverse_root) {
    __shared__ uint32 found[kChunk / 32];  // a bit for each number, set if it has a gradient
    const uint32 thread = threadIdx.x;
    const int64 row = int64(blockIdx.x) * rows_each, at = row * width;
    const uint32 n = uint32(rows - row < rows_each ? rows - row : rows_each) * width;

    float g[kEach];
    bool on[kEach];
#pragma unroll
    for (int j = 0; j < kEach; ++j) {
        const uint32 i = thread + j * kAdamThreads;
        g[j] = i < n ? gradient[at + i] : 0.0f;
    }
#pragma unroll
    for (int j = 0; j < kEach; ++j) {
        const uint32 bits = __ballot_sync(kAllLanes, is_gradient(g[j]));
        if (thread % 32 == 0) found[(thread + j * kAdamThreads) / 32] = bits;
    }
    __syncthreads();
#pragma unroll
    for (int j = 0; j < kEach; ++j) {
        const uint32 i = thread + j * kAdamThreads;
        const uint32 begin = __umulhi(2 * i, divide) * width;  // i / width * width: exact, as i and width are at most kChunk
        on[j] = i < n && any_bit(found, begin, begin + width - 1);
    }
    step_chunk(Adam{rate, beta1, beta2, epsilon, inverse_root}, g, on, parameter + at, first + at, second + at);
}

// Wide rows: a block takes one of a row's `parts` of kChunk numbers (the last one may be shorter). found [rows, parts]: 1 if a part has a gradient.
extern "C" __global__ void __launch_bounds__(kAdamThreads) find_gradients(int64 width, int parts, const float* gradient, uint8* found) {
    const int64 row = blockIdx.x / parts, from = int64(blockIdx.x % parts) * kChunk;
    bool any = false;
#pragma unroll
    for (int j = 0; j < kEach; ++j) {
        const int64 i = from + threadIdx.x + j * kAdamThreads;
        any |= i < width && is_gradient(gradient[row * width + i]);
    }
    const int all = __syncthreads_or(any);
    if (threadIdx.x == 0) found[blockIdx.x] = all != 0;
}

// Uses the same blocks as find_gradients, and runs after it.
extern "C" __global__ void __launch_bounds__(kAdamThreads)
    adam_wide(int64 width, int parts, const uint8* found, float* parameter, const float* gradient, float* first, float* second, float rate, float beta1,
              float beta2, float epsilon, float inverse_root) {
    const int thread = int(threadIdx.x);
    const int64 row = blockIdx.x / parts, from = int64(blockIdx.x % parts) * kChunk, at = row * width + from;
    bool any = false;
#pragma unroll 1
    for (int i = thread; i < parts; i += kAdamThreads) any |= found[row * parts + i] != 0;
    if (!__syncthreads_or(any)) return;
    float g[kEach];
    bool on[kEach];
#pragma unroll
    for (int j = 0; j < kEach; ++j) {
        const int i = thread + j * kAdamThreads;
        on[j] = i < width - from;
        g[j] = on[j] ? gradient[at + i] : 0.0f;
    }
    step_chunk(Adam{rate, beta1, beta2, epsilon, inverse_root}, g, on, parameter + at, first + at, second + at);
}
