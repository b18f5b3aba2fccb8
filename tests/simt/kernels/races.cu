// Accesses of two threads to one place. In `passed_on` and `added_up` something orders them, or they cannot harm; the others are
// races, though threads in their natural order may get what was meant.
constexpr unsigned kAll = 0xffffffffu;

// From lane 0 to lane 2, by way of lane 1 where `by_way` holds.
extern "C" __global__ void __launch_bounds__(32) passed_on(bool by_way, int* out) {
    __shared__ int kept[4];
    const int lane = threadIdx.x;
    if (lane == 0) kept[0] = 7;
    if (lane < 2) __syncwarp(3u);
    if (by_way && (lane == 1 || lane == 2)) __syncwarp(6u);
    if (lane == 2) out[0] = kept[0];
}

// Atomics; writes of the same value; bytes beside one another; a block's memory again in the next block.
extern "C" __global__ void __launch_bounds__(64) added_up(int* sum, int* flag, unsigned char* bytes) {
    __shared__ int kept[64];
    kept[threadIdx.x] = int(threadIdx.x);
    atomicAdd(sum, kept[threadIdx.x]);
    if (kept[threadIdx.x] >= 0) *flag = 1;
    bytes[blockIdx.x * blockDim.x + threadIdx.x] = 1;
}

extern "C" __global__ void __launch_bounds__(32) shuffled(int* out) {
    __shared__ int kept[32];
    kept[threadIdx.x] = int(threadIdx.x);
    const int other = __shfl_xor_sync(kAll, int(threadIdx.x), 1);  // all have come here, but nobody need see what they wrote
    out[threadIdx.x] = kept[other];
}

extern "C" __global__ void __launch_bounds__(64) across_warps(int* out) {
    __shared__ int kept[64];
    kept[threadIdx.x] = int(threadIdx.x);
    __syncwarp();
    out[threadIdx.x] = kept[threadIdx.x / 64 * 64];
}

extern "C" __global__ void __launch_bounds__(32) across_blocks(int* out) {
    if (threadIdx.x == 0) out[3] = int(blockIdx.x);
}

extern "C" __global__ void __launch_bounds__(32) read_of_an_atomic(int* out) {
    atomicAdd(out, 1);
    if (threadIdx.x == 31) out[1] = out[0];
}

extern "C" __global__ void __launch_bounds__(64) part_of_a_vector(float4* out) {
    reinterpret_cast<float*>(out)[threadIdx.x] = 1;
    __syncwarp();
    if (threadIdx.x == 1) out[12] = make_float4(0, 0, 0, 0);
}
