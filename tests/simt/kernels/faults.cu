// What a processor refuses. Thread 40 does it.
namespace {

__device__ __noinline__ int deeper(int n, int* out) {
    volatile int kept[1000];
    kept[n % 1000] = n;
    return n < 0 ? 0 : deeper(n + 1, out) + kept[3] + *out;
}

}  // namespace

extern "C" __global__ void read_nothing(const int* at, int* out) {
    if (threadIdx.x == 40) out[0] = at[7];
}

extern "C" __global__ void divide(int by, int* out) {
    if (threadIdx.x == 40) out[0] = 7 / by;
}

extern "C" __global__ void never_end(int* out) {
    if (threadIdx.x == 40)
        while (*static_cast<volatile int*>(out) == 0) continue;
}

extern "C" __global__ void use_up_the_stack(int* out) {
    if (threadIdx.x == 40) out[0] = deeper(0, out);
}

extern "C" __global__ void go_out_of_bounds(int by, int* out) {
    __shared__ int kept[64];
    kept[threadIdx.x + by] = 1;
    __syncthreads();
    out[threadIdx.x] = kept[threadIdx.x];
}

extern "C" __global__ void write_misaligned(float* out) {
    if (threadIdx.x == 40) *reinterpret_cast<float4*>(out + 1) = make_float4(1, 2, 3, 4);
}
