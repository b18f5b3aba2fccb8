// The window of SSIM along one axis: 11 taps of a Gaussian with sigma 1.5.
#pragma once
#include "device.cuh"

namespace e4dgs {

constexpr int kRadius = 5;

// exp(-(k - 5)^2 / 4.5), divided by the sum over all taps. A function, because device code cannot index an array on the host.
__device__ constexpr float tap(int k) {
    const int d = k < kRadius ? kRadius - k : k - kRadius;
    return d == 0   ? 0.26601172486179436f
           : d == 1 ? 0.2130055377112537f
           : d == 2 ? 0.10936068950970002f
           : d == 3 ? 0.03600077212843083f
           : d == 4 ? 0.007598758135239185f
                    : 0.00102838008447911f;
}

// out [N]: in(0) ... in(N + 2 kRadius - 1), blurred. Each input is read only once, so that few of them occupy a register at a time.
template <int N, class F>
__device__ __forceinline__ void blur(F&& in, float* out) {
#pragma unroll
    for (int j = 0; j < N + 2 * kRadius; ++j) {
        const float value = in(j);
#pragma unroll
        for (int i = 0; i < N; ++i) {
            if (j == i) out[i] = tap(0) * value;
            if (j > i && j <= i + 2 * kRadius) out[i] = fmaf(tap(j - i), value, out[i]);
        }
    }
}

}  // namespace e4dgs
