// Many sums over a warp at once. Summing V values one after another takes 5 V exchanges; here lanes share the values out among
// themselves while they add: with each exchange a lane hands half of its values over and keeps the other half, so that V <= 32 values
// take about V exchanges, and each total ends in a lane of its own, ready for one store or one atomic by all lanes together.
#pragma once
#include "device.cuh"

namespace e4dgs {

__host__ __device__ constexpr int next_power(int n) { return n <= 1 ? 1 : 2 * next_power((n + 1) / 2); }

// Halving from HALF values on, lanes `OFFSET` apart; COUNT values are left.
template <int COUNT, int HALF, int OFFSET, class T>
__device__ __forceinline__ void warp_halve(T* v, int lane) {
    if constexpr (OFFSET > 0) {
        if constexpr (HALF >= 1) {
            const bool upper = lane & OFFSET;
#pragma unroll
            for (int i = 0; i < HALF && i < COUNT; ++i) {
                if (i + HALF < COUNT) {
                    const T keep = upper ? v[i + HALF] : v[i], give = upper ? v[i] : v[i + HALF];
                    v[i] = keep + __shfl_xor_sync(kAllLanes, give, OFFSET);
                } else {
                    v[i] = v[i] + __shfl_xor_sync(kAllLanes, v[i], OFFSET);  // nobody to swap with: both lanes keep it
                }
            }
            warp_halve<(COUNT < HALF ? COUNT : HALF), HALF / 2, OFFSET / 2>(v, lane);
        } else {
            v[0] = v[0] + __shfl_xor_sync(kAllLanes, v[0], OFFSET);
            warp_halve<1, 0, OFFSET / 2>(v, lane);
        }
    }
}

// Which of V values' totals a lane holds after warp_totals; -1 where another lane holds the same.
template <int V>
__device__ __forceinline__ int warp_total_of(int lane) {
    constexpr int steps = 5;
    int half[steps], count[steps], at = 0;
    int h = next_power(V) / 2, c = V;
#pragma unroll
    for (int s = 0; s < steps; ++s) {
        half[s] = h, count[s] = c;
        c = h >= 1 && h < c ? h : h >= 1 ? c : 1;
        h /= 2;
    }
#pragma unroll
    for (int s = steps - 1; s >= 0; --s) {
        if (!(lane & (16 >> s))) continue;
        if (half[s] >= 1 && at + half[s] < count[s])
            at += half[s];
        else
            return -1;
    }
    return at;
}

// v [V], V <= 32, of every lane; returns the total that warp_total_of names. Destroys v.
template <int V, class T>
__device__ __forceinline__ T warp_totals(T* v, int lane) {
    static_assert(V <= 32);
    warp_halve<V, next_power(V) / 2, 16>(v, lane);
    return v[0];
}

}  // namespace e4dgs
