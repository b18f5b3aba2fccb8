// Where a point lies among the samples of six feature planes, and the values of a lane's four channels on each. A group of CHANNELS / 4 lanes does one
// point. Compile-time features: CHANNELS (a multiple of 4), LEVELS (1 to 4).
#pragma once
#include "quads.cuh"

#if !defined(CHANNELS)
#define CHANNELS 16
#endif
#if !defined(LEVELS)
#define LEVELS 2
#endif

namespace e4dgs {

constexpr int kQuads = CHANNELS / 4;  // lanes per point
constexpr int kMostLevels = 4;        // levels in a kernel's parameters; those from LEVELS on are unused

// Two neighbouring samples, low and the next one, or low alone if there is only one sample.
struct __align__(8) Tap {
    int low;
    float fraction;
};

// u in [0, 1] among `count` samples whose ends are at 0 and 1. Values outside are clamped, and NaN counts as 0.
__device__ __forceinline__ Tap tap_of(float u, int count) {
    const float x = __saturatef(u) * float(count - 1);
    const int last = count > 1 ? count - 2 : 0, at = int(x), low = at < last ? at : last;
    return {low, x - float(low)};
}

struct Taps {
    Tap axis[3];
};

__device__ __forceinline__ Taps taps_of(const float* u, int resolution) {
    return {{tap_of(u[0], resolution), tap_of(u[1], resolution), tap_of(u[2], resolution)}};
}

// A point [3] relative to the box with corners low and high [3], in [0, 1] along each side; low is null for the unit box.
__device__ __forceinline__ void place_in(const float* low, const float* high, const float* point, float* u) {
    for (int j = 0; j < 3; ++j) u[j] = __ldg(point + j);
    if (!low) return;
    float begin[3], end[3];
    for (int j = 0; j < 3; ++j) begin[j] = __ldg(low + j), end[j] = __ldg(high + j);
    for (int j = 0; j < 3; ++j) u[j] = (u[j] - begin[j]) / (end[j] - begin[j]);
}

// The four samples around a point on a space plane (0: xy, 1: xz, 2: yz) [R, R, CHANNELS], the first coordinate varying fastest.
struct Cell {
    int at[4];  // in floats from the plane's start
    float weight[4];
};

__device__ __forceinline__ Cell cell_of(const Taps& taps, int plane, int resolution) {
    const Tap a = taps.axis[plane == 2], b = taps.axis[plane ? 2 : 1];
    const int right = resolution > 1 ? CHANNELS : 0, up = right * resolution, low = (b.low * resolution + a.low) * CHANNELS;
    const float a0 = 1.0f - a.fraction, b0 = 1.0f - b.fraction;
    return {{low, low + right, low + up, low + up + right}, {a0 * b0, a.fraction * b0, a0 * b.fraction, a.fraction * b.fraction}};
}

__device__ __forceinline__ int64 plane_start(int plane, int resolution) { return int64(plane) * resolution * resolution * CHANNELS; }

// v [6]: channels 4 quad to 4 quad + 3 on the planes space [3, R, R, CHANNELS] and the lines [3, R, CHANNELS] of one level.
__device__ __forceinline__ void values_of(const float* space, const float* lines, int resolution, const Taps& taps, int quad, float4* v) {
    const int next = resolution > 1 ? CHANNELS : 0;
#pragma unroll
    for (int k = 0; k < 3; ++k) {
        const Cell cell = cell_of(taps, k, resolution);
        const float* plane = space + plane_start(k, resolution) + 4 * quad;
        v[k] = times(cell.weight[0], load_quad(plane + cell.at[0]));
#pragma unroll
        for (int c = 1; c < 4; ++c) v[k] = plus(v[k], cell.weight[c], load_quad(plane + cell.at[c]));
        const Tap tap = taps.axis[k];
        const float* line = lines + (k * resolution + tap.low) * CHANNELS + 4 * quad;
        v[3 + k] = plus(times(1.0f - tap.fraction, load_quad(line)), tap.fraction, load_quad(line + next));
    }
}

}  // namespace e4dgs
