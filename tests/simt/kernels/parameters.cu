// One parameter of each kind; BIAS is a macro's.
struct Record {
    float x, y;
};

extern "C" __global__ void __launch_bounds__(32 * (1 + 1), 2)
    take(int n, unsigned u, long long l, unsigned long long v, float f, double d, bool flag, const float* __restrict__ x,
         const Record* records, double* out) {
    if (threadIdx.x) return;
    const double numbers[] = {double(n), double(u), double(l), double(v), f, d, double(flag), x ? double(x[0]) : -1, records[1].y, BIAS};
    for (int i = 0; i < 10; ++i) out[i] = numbers[i];
}

#if BIAS > 5
extern "C" __global__ void only_with_a_bias() {}
#endif
