// The deformation field's features: planes over space and time at several levels, looked up for all points at one time. Compile-time features:
// see field.cuh.
#include "field.cuh"

using namespace e4dgs;

// Interpolates the time planes [3, T, R, CHANNELS] of all levels at time t in [0, 1]: lines [sum of 3 R, CHANNELS], level after level. Each thread
// does four channels.
extern "C" __global__ void __launch_bounds__(256)
    blend_lines(float t, const float* time0, const float* time1, const float* time2, const float* time3, int times0, int times1, int times2, int times3,
                int resolution0, int resolution1, int resolution2, int resolution3, float* lines) {
    const float* const time[kMostLevels] = {time0, time1, time2, time3};
    const int times_of[kMostLevels] = {times0, times1, times2, times3}, resolution[kMostLevels] = {resolution0, resolution1, resolution2, resolution3};
    const int place = int(blockIdx.x * blockDim.x + threadIdx.x);
    int k = place;
#pragma unroll
    for (int l = 0; l < LEVELS; ++l) {
        const int row = resolution[l] * kQuads;
        if (k >= 0 && k < 3 * row) {
            const Tap tap = tap_of(t, times_of[l]);
            const float* from = time[l] + 4 * ((int64(k / row) * times_of[l] + tap.low) * row + k % row);
            const float* next = from + (times_of[l] > 1 ? 4 * row : 0);
            store_quad(lines + 4 * int64(place), plus(times(1.0f - tap.fraction, load_quad(from)), tap.fraction, load_quad(next)));
        }
        k -= 3 * row;
    }
}

// features [n, LEVELS * CHANNELS] of points [n, 3]. low, high [3]: corners of the box, null for the unit box. space [3, R, R, CHANNELS] of each level.
extern "C" __global__ void __launch_bounds__(256)
    look_up(int n, const float* points, const float* low, const float* high, const float* space0, const float* space1, const float* space2,
            const float* space3, int resolution0, int resolution1, int resolution2, int resolution3, const float* lines, float* features) {
    const float* const space[kMostLevels] = {space0, space1, space2, space3};
    const int resolution[kMostLevels] = {resolution0, resolution1, resolution2, resolution3};
    constexpr int points_here = 256 / kQuads;
    const int slot = int(threadIdx.x) / kQuads, quad = int(threadIdx.x) % kQuads;
    const int64 i = int64(blockIdx.x) * points_here + slot;
    if (slot >= points_here || i >= n) return;
    float u[3];
    place_in(low, high, points + 3 * i, u);
#pragma unroll
    for (int l = 0; l < LEVELS; ++l) {
        float4 v[6];
        values_of(space[l], lines, resolution[l], taps_of(u, resolution[l]), quad, v);
        store_quad(features + (i * LEVELS + l) * CHANNELS + 4 * quad, times(times(times(v[0], v[1]), v[2]), times(times(v[3], v[4]), v[5])));
        lines += 3 * resolution[l] * CHANNELS;
    }
}
