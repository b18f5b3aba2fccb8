// What is in shared memory, and when.
template <int N>
__device__ float* of_template() {
    __shared__ float x[N];
    return x;
}

__device__ inline float* of_inline() {
    __shared__ float x[64];
    return x;
}

// out [3, 64]: what nobody wrote. The second of two launches must not see what the first leaves behind.
extern "C" __global__ void __launch_bounds__(64) unwritten(float* out) {
    __shared__ alignas(16) float x[64];
    float* const all[] = {x, of_template<64>(), of_inline()};
    for (int i = 0; i < 3; ++i) out[i * 64 + threadIdx.x] = all[i][threadIdx.x], all[i][threadIdx.x] = 1;
}

// Passes numbers on to the next thread `times` times; without barriers it may get what was there before, or what comes after.
extern "C" __global__ void __launch_bounds__(256) rotate(bool barriers, int times, const int* x, int* out) {
    __shared__ int kept[256];
    const unsigned i = threadIdx.x;
    kept[i] = x[i];
    __syncthreads();
    for (int t = 0; t < times; ++t) {
        const int next = kept[(i + 1) % blockDim.x];
        if (barriers) __syncthreads();
        kept[i] = next;
        if (barriers) __syncthreads();
    }
    out[i] = kept[i];
}

// The order in which threads come to this, twice.
extern "C" __global__ void __launch_bounds__(256) line_up(int* length, int* order) {
    for (int i = 0; i < 2; ++i) {
        order[atomicAdd(length, 1)] = int(blockIdx.x * blockDim.x + threadIdx.x);
        __syncthreads();
    }
}

// Threads without a number leave; the others still meet.
extern "C" __global__ void __launch_bounds__(256) sum_of_some(int n, const int* x, int* sum) {
    __shared__ int total;
    if (threadIdx.x == 0) total = 0;
    if (int(threadIdx.x) >= n) return;
    __syncthreads();
    atomicAdd(&total, x[threadIdx.x]);
    __syncthreads();
    sum[threadIdx.x] = total;
}
