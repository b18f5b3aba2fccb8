// What the image terms compare: a render with the capture, in front of the background that was rendered or of its opposite.
#pragma once
#include "device.cuh"

namespace e4dgs {

// One number of both images. raw: as rendered. x: as recorded; y where the weight is 0.
struct Pair {
    float raw, x, y, weight;
};

struct Pictures {
    const float *image, *target;   // [height, width, 3]
    const float* weight;           // [height, width], or null: 1
    const float *gain, *offset;    // [3], or null: 1 and 0
    const float *alpha, *known;    // [height, width], of the render and of the capture, for the opposite background; or null
    const bool* kept;              // [height, width], or null: true. Where it is false, the opposite background shows y = raw
    float red, green, blue;        // the opposite background minus the one that was rendered

    __device__ __forceinline__ float change(int channel) const { return channel == 0 ? red : channel == 1 ? green : blue; }

    __device__ __forceinline__ Pair pair(int64 pixel, int channel, bool opposite) const {
        const int64 at = 3 * pixel + channel;
        float raw = image[at], y = target[at];
        if (opposite) {
            raw = fmaf(1.0f - alpha[pixel], change(channel), raw), y = fmaf(1.0f - known[pixel], change(channel), y);
            if (kept && !kept[pixel]) y = raw;
        }
        const float w = weight_of(pixel), recorded = gain ? fmaf(gain[channel], raw, offset[channel]) : raw;
        return {raw, w != 0.0f ? recorded : y, y, w};
    }

    __device__ __forceinline__ float weight_of(int64 pixel) const { return weight ? weight[pixel] : 1.0f; }

    // By how much the render's alpha is too large, where it counts.
    __device__ __forceinline__ float excess(int64 pixel) const {
        return (kept && !kept[pixel]) || weight_of(pixel) == 0.0f ? 0.0f : alpha[pixel] - known[pixel];
    }
};

__device__ __forceinline__ float sign_of(float a) { return a > 0.0f ? 1.0f : a < 0.0f ? -1.0f : 0.0f; }

}  // namespace e4dgs
