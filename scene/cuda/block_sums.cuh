// Sums over the threads of a block.
#pragma once
#include "warp_sum.cuh"

namespace e4dgs {

// The sums of value [V] over the THREADS threads of the block, to out [V], always in the same order. Destroys value.
template <int THREADS, int V>
__device__ __forceinline__ void block_sums(float* value, float* out) {
    __shared__ float warps[THREADS / 32][V];
    const int thread = int(threadIdx.x), which = warp_total_of<V>(thread % 32);
    const float total = warp_totals<V>(value, thread % 32);
    if (which >= 0) warps[thread / 32][which] = total;
    __syncthreads();
    if (thread >= V) return;
    float sum = 0.0f;
    for (int w = 0; w < THREADS / 32; ++w) sum += warps[w][thread];
    out[thread] = sum;
}

}  // namespace e4dgs
