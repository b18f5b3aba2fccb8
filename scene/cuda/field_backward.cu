// Gradients of the field's features with respect to its planes. Each sample of a space plane gets gradients from few points, so they are added
// atomically in global memory. The lines (the time planes interpolated at the frame's time) have only a few dozen samples, which all points of the
// frame share, so a block sums their gradients in shared memory first. Atomic float additions in shared memory are no faster than a loop of
// exchanges, so they are avoided: threads stage their values, and a few threads, each of which owns a piece of the sums, add them up.
// Compile-time features: see field.cuh, and LINES (quads of all lines together if they fit into shared memory; 0 if not: lines are then added to
// like planes).
#include "field.cuh"

#if !defined(LINES)
#define LINES 576
#endif

namespace e4dgs {

constexpr int kFieldThreads = 128;
constexpr int kPoints = kFieldThreads / kQuads;  // points that a block takes at a time

// From values [6] and the gradient of their product to the gradients of the values, with products from the left and from the right, so that
// nothing is divided by a value that may be zero.
__device__ __forceinline__ void product_backward(float4* v, float4 grad) {
    float4 right[6];
    right[4] = v[5];
#pragma unroll
    for (int k = 3; k >= 0; --k) right[k] = times(right[k + 1], v[k + 1]);
#pragma unroll
    for (int k = 0; k < 5; ++k) {
        const float4 value = v[k];
        v[k] = times(grad, right[k]);
        grad = times(grad, value);
    }
    v[5] = grad;
}

#if LINES
constexpr int kAhead = 4;  // points that are read together before any is added

// Adds the values that `count` points have staged [3][kPoints, kQuads], at taps [3][kPoints], to sums [3, R, kQuads] of a level. A piece is four
// channels of a line, at its even or at its odd samples. The two neighbouring samples of a point are one of each kind, so the owners of pieces
// have equal work and never write to the same sum.
__device__ __forceinline__ void add_staged(const float4 (*staged)[kFieldThreads], const Tap (*taps)[kPoints], int count, int resolution, float4* sums) {
    for (int piece = int(threadIdx.x); piece < 6 * kQuads; piece += kFieldThreads) {
        const int axis = piece / (2 * kQuads), odd = piece / kQuads % 2, quad = piece % kQuads;
        if (odd >= resolution) continue;  // there is only one sample
        for (int first = 0; first < count; first += kAhead) {
            int at[kAhead];
            float4 value[kAhead];
#pragma unroll
            for (int j = 0; j < kAhead; ++j) {
                const int i = first + j < count ? first + j : first;
                const Tap tap = taps[axis][i];
                const bool next = (tap.low & 1) != odd;
                at[j] = (axis * resolution + tap.low + next) * kQuads + quad;
                value[j] = times(next ? tap.fraction : 1.0f - tap.fraction, staged[axis][i * kQuads + quad]);
            }
#pragma unroll
            for (int j = 0; j < kAhead; ++j)  // one after another, because points share samples
                if (first + j < count) sums[at[j]] = plus(sums[at[j]], 1.0f, value[j]);
        }
    }
}
#endif

}  // namespace e4dgs

using namespace e4dgs;

// Arguments as in look_up. Adds to dspace [3, R, R, CHANNELS] of each level and to dlines, which has the layout of lines. Any number of blocks.
extern "C" __global__ void __launch_bounds__(kFieldThreads, 4)
    look_up_backward(int n, const float* points, const float* low, const float* high, const float* space0, const float* space1, const float* space2,
                     const float* space3, int resolution0, int resolution1, int resolution2, int resolution3, const float* lines, const float* dfeatures,
                     float* dspace0, float* dspace1, float* dspace2, float* dspace3, float* dlines) {
    const float* const space[kMostLevels] = {space0, space1, space2, space3};
    float* const dspace[kMostLevels] = {dspace0, dspace1, dspace2, dspace3};
    const int resolution[kMostLevels] = {resolution0, resolution1, resolution2, resolution3};
    const int slot = int(threadIdx.x) / kQuads, quad = int(threadIdx.x) % kQuads;
#if LINES
    __shared__ float4 sums[LINES];
    __shared__ float4 staged[3][kFieldThreads];
    __shared__ Tap places[3][kPoints];
    int length = 0;
#pragma unroll
    for (int l = 0; l < LEVELS; ++l) length += 3 * resolution[l] * kQuads;
    for (int k = int(threadIdx.x); k < length; k += kFieldThreads) sums[k] = make_float4(0.0f, 0.0f, 0.0f, 0.0f);
#endif
    for (int64 first = int64(blockIdx.x) * kPoints; first < n; first += int64(gridDim.x) * kPoints) {
        const int64 i = first + slot;
        const int count = n - first < kPoints ? int(n - first) : kPoints;
        float u[3];
        if (slot < count) place_in(low, high, points + 3 * i, u);
        int start = 0;  // of the level's lines, in rows of CHANNELS
#pragma unroll
        for (int l = 0; l < LEVELS; ++l) {
            const int r = resolution[l];
            if (slot < count) {
                const Taps taps = taps_of(u, r);
                float4 v[6];
                values_of(space[l], lines + start * CHANNELS, r, taps, quad, v);
                product_backward(v, load_quad(dfeatures + (i * LEVELS + l) * CHANNELS + 4 * quad));
#pragma unroll
                for (int k = 0; k < 3; ++k) {
                    const Cell cell = cell_of(taps, k, r);
                    float* plane = dspace[l] + plane_start(k, r) + 4 * quad;
#pragma unroll
                    for (int c = 0; c < 4; ++c) add_quad(plane + cell.at[c], times(cell.weight[c], v[k]));
#if LINES
                    staged[k][threadIdx.x] = v[3 + k];
                    if (quad == 0) places[k][slot] = taps.axis[k];
#else
                    const Tap tap = taps.axis[k];
                    float* line = dlines + (start + k * r + tap.low) * CHANNELS + 4 * quad;
                    add_quad(line, times(1.0f - tap.fraction, v[3 + k]));
                    if (r > 1) add_quad(line + CHANNELS, times(tap.fraction, v[3 + k]));
#endif
                }
            }
#if LINES
            __syncthreads();
            add_staged(staged, places, count, r, sums + start * kQuads);
            __syncthreads();
#endif
            start += 3 * r;
        }
    }
#if LINES
    for (int k = int(threadIdx.x); k < length; k += kFieldThreads) add_quad(dlines + 4 * k, sums[k]);
#endif
}

// Distributes the gradients of the lines to the two samples in time between which they lie. All of dtime [3, T, R, CHANNELS] of each level is written,
// with zeros elsewhere. Each thread does four channels.
extern "C" __global__ void __launch_bounds__(256)
    spread_lines(float t, int times0, int times1, int times2, int times3, int resolution0, int resolution1, int resolution2, int resolution3,
                 const float* dlines, float* dtime0, float* dtime1, float* dtime2, float* dtime3) {
    const int times_of[kMostLevels] = {times0, times1, times2, times3}, resolution[kMostLevels] = {resolution0, resolution1, resolution2, resolution3};
    float* const dtime[kMostLevels] = {dtime0, dtime1, dtime2, dtime3};
    int64 k = int64(blockIdx.x) * blockDim.x + threadIdx.x;
#pragma unroll
    for (int l = 0; l < LEVELS; ++l) {
        const int row = resolution[l] * kQuads;
        const int64 plane = int64(times_of[l]) * row;
        if (k >= 0 && k < 3 * plane) {
            const Tap tap = tap_of(t, times_of[l]);
            const int axis = int(k / plane), time = int(k % plane / row);
            float4 value = make_float4(0.0f, 0.0f, 0.0f, 0.0f);
            if (time == tap.low || time == tap.low + 1)
                value = times(time == tap.low ? 1.0f - tap.fraction : tap.fraction, load_quad(dlines + 4 * (axis * row + k % row)));
            store_quad(dtime[l] + 4 * k, value);
        }
        k -= 3 * plane;
        dlines += 3 * resolution[l] * CHANNELS;
    }
}
