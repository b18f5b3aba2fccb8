// Meetings that not all come to. Each kernel has its test; on a GPU they would hang, or give whatever comes.
constexpr unsigned kAll = 0xffffffffu;

extern "C" __global__ void different_kinds(int* out) {
    if (threadIdx.x % 32 < 16)
        out[threadIdx.x] = __shfl_sync(kAll, 1, 0);
    else
        out[threadIdx.x] = int(__ballot_sync(kAll, 1));
}

extern "C" __global__ void different_masks(int* out) { out[threadIdx.x] = __shfl_sync(threadIdx.x % 32 ? kAll : 1u | 1u << 5, 1, 0); }

extern "C" __global__ void different_places(int*) {
    if (threadIdx.x == 7)
        __syncwarp();
    else
        __syncwarp();
}

extern "C" __global__ void one_has_ended(int* out) {
    if (threadIdx.x % 32 == 3) return;
    out[threadIdx.x] = __shfl_xor_sync(kAll, 1, 1);
}

extern "C" __global__ void one_is_at_the_barrier(int*) {
    if (threadIdx.x == 40) __syncthreads();
    __syncwarp();
    __syncthreads();
}

extern "C" __global__ void half_a_block(int* out) {
    if (threadIdx.x < blockDim.x / 2) __syncthreads();
    out[threadIdx.x] = 1;
    __syncthreads();
}

extern "C" __global__ void not_in_its_mask(int*) { __syncwarp(0xffffu); }

extern "C" __global__ void fine(int* out) { out[threadIdx.x] = __shfl_sync(kAll, int(threadIdx.x), 5); }
