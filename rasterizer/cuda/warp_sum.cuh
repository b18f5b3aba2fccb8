// Many sums over a warp at once. Summing V values one after another takes 5 V exchanges. Here the lanes divide the values among
// themselves while they add: in each step a lane gives away half of its values and keeps the other half. So V <= 32 values
// take about V exchanges, and each total ends up in its own lane, ready for one store or one atomic by all lanes together.
#pragma once
#include "device.cuh"

namespace e4dgs {

__host__ __device__ constexpr int next_power(int n) { return n <= 1 ? 1 : 2 * next_power((n + 1) / 2); }

// One step and all later ones: exchanges up to HALF of the COUNT values that are left with the lane `OFFSET` away.
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
                    v[i] = v[i] + __shfl_xor_sync(kAllLanes, v[i], OFFSET);  // there is no value to swap it with, so both lanes keep it
                }
            }
            warp_halve<(COUNT < HALF ? COUNT : HALF), HALF / 2, OFFSET / 2>(v, lane);
        } else {
            v[0] = v[0] + __shfl_xor_sync(kAllLanes, v[0], OFFSET);
            warp_halve<1, 0, OFFSET / 2>(v, lane);
        }
    }
}

// The index of the total, among V, that a lane holds after warp_totals; -1 if it is a duplicate of another lane's.
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

// Sums v [V], V <= 32, over all lanes. Each lane gets the total whose index warp_total_of returns. Destroys v.
template <int V, class T>
__device__ __forceinline__ T warp_totals(T* v, int lane) {
    static_assert(V <= 32);
    warp_halve<V, next_power(V) / 2, 16>(v, lane);
    return v[0];
}

}  // namespace e4dgs
