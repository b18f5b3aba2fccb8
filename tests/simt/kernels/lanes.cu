// What lanes tell one another, and atomics.
namespace e4dgs {

constexpr unsigned kAll = 0xffffffffu;

// out [5, 32]: each way to exchange, of 100 + lane.
extern "C" __global__ void __launch_bounds__(32) exchange(int by, double* out) {
    const int lane = threadIdx.x;
    const double x = 100 + lane;
    out[lane] = __shfl_sync(kAll, x, by + lane);
    out[32 + lane] = __shfl_up_sync(kAll, x, by);
    out[64 + lane] = __shfl_down_sync(kAll, x, by);
    out[96 + lane] = __shfl_xor_sync(kAll, float(x), by);
    out[128 + lane] = double(__shfl_sync(kAll, (long long)(x) << 40, by) >> 40);
}

// out [6, 32]: what the lanes agree on.
extern "C" __global__ void __launch_bounds__(32) agree(const int* x, unsigned* out) {
    const int lane = threadIdx.x, mine = x[lane];
    out[lane] = __ballot_sync(kAll, mine > 2);
    out[32 + lane] = __match_any_sync(kAll, mine);
    out[64 + lane] = unsigned(__any_sync(kAll, mine == 2));
    out[96 + lane] = unsigned(__all_sync(kAll, mine == 2));
    if (lane < 8) {  // the others are not asked, and wait where all meet again
        out[128 + lane] = __ballot_sync(0xffu, lane % 2);
        out[160 + lane] = unsigned(__shfl_down_sync(0xffu, lane, 4));
    }
    __syncwarp();
}

// The number of threads for which x holds, three ways; and whether it holds for any, for all.
extern "C" __global__ void __launch_bounds__(1024) count(const int* x, int* out) {
    const int holds = x[threadIdx.x] != 0;
    out[threadIdx.x] = __syncthreads_count(holds);
    out[blockDim.x + threadIdx.x] = __syncthreads_or(holds);
    out[2 * blockDim.x + threadIdx.x] = __syncthreads_and(holds);
}

// Each of n numbers once: their sums, extremes, histogram (of x modulo 8) and a list without order.
extern "C" __global__ void __launch_bounds__(64)
    gather(int n, const int* x, int* sum, float* float_sum, double* double_sum, unsigned long long* big_sum, int* low, unsigned* high,
           unsigned* histogram, unsigned* length, int* list) {
    const int i = int(blockIdx.x * blockDim.x + threadIdx.x);
    if (i >= n) return;
    atomicAdd(sum, x[i]);
    atomicAdd(float_sum, 1);
    atomicAdd(double_sum, 0.5 * x[i]);
    atomicAdd(big_sum, 1ull << 33);
    atomicMin(low, x[i]);
    atomicMax(high, unsigned(x[i]));
    for (unsigned seen = histogram[x[i] & 7], before; (before = atomicCAS(&histogram[x[i] & 7], seen, seen + 1)) != seen;) seen = before;
    list[atomicAdd(length, 1u)] = x[i];
}

}  // namespace e4dgs
