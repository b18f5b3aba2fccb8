// Reads the camera, and the looks that both kinds have: colours (from SH or given directly) and extras, which must be finite.
#pragma once
#include "device.cuh"
//
#include "sh.h"

#if !defined(SH_DEGREE)
#define SH_DEGREE -1  // colours are given directly
#endif

#if !defined(ANTIALIASED)
#define ANTIALIASED 0
#endif

namespace e4dgs {

constexpr int kShDegree = SH_DEGREE < 0 ? 0 : SH_DEGREE;
constexpr int kShCoefficients = (kShDegree + 1) * (kShDegree + 1);
constexpr int kLooks = 3 * (SH_DEGREE < 0 ? 1 : kShCoefficients);  // numbers of a primitive's looks

// numbers: fx fy cx cy, R [9], t [3], near. One thread completes the camera for its block; all threads call this.
__device__ inline const Camera<double>& camera_of(const double* numbers, int width, int height) {
    __shared__ Camera<double> cam;
    if (threadIdx.x == 0) {
        cam.fx = numbers[0], cam.fy = numbers[1], cam.cx = numbers[2], cam.cy = numbers[3];
        for (int i = 0; i < 9; ++i) cam.R[i] = numbers[4 + i];
        for (int i = 0; i < 3; ++i) cam.t[i] = numbers[13 + i];
        cam.near_z = numbers[16];
        cam.width = width, cam.height = height;
        complete(cam);
    }
    __syncthreads();
    return cam;
}

// looks: sh [n, (D+1)^2, 3], or colors [n, 3] if SH_DEGREE is -1.
__device__ inline bool usable_looks(const float* looks, const float* extras, int channels, int64 i) {
    bool good = true;
    for (int k = 0; k < kLooks; ++k) good &= is_finite(looks[i * kLooks + k]);
    for (int e = 0; e < channels; ++e) good &= is_finite(extras[i * channels + e]);
    return good;
}

// Writes row i of a gradient [n, width], which may be null, of a primitive that no pixel blends.
__device__ inline void write_zeros(float* gradient, int64 i, int width) {
    for (int k = 0; gradient && k < width; ++k) gradient[i * width + k] = 0.0f;
}

// Colours are computed in float, as on the CPU, but the view direction in double: the camera may be far from the origin and close to the
// primitive. position [3]: the centre or centroid, world.
__device__ inline void color_of(const Camera<double>& cam, const double* position, const float* looks, int64 i, float* color) {
#if SH_DEGREE < 0
    for (int c = 0; c < 3; ++c) color[c] = looks[3 * i + c];
#else
    double unit[3], inverse_length;
    view_direction(cam, position, unit, inverse_length);
    float B[kShCoefficients];
    sh_basis<kShDegree>(float(unit[0]), float(unit[1]), float(unit[2]), B);
    sh_color<kShDegree>(B, looks + kLooks * i, color);
#endif
}

// dlooks may be null. Adds to dposition.
template <class G>
__device__ inline void color_backward(const Camera<double>& cam, const double* position, const float* looks, int64 i, const float* dcolor, float* dlooks,
                                      double* dposition, G& grad) {
#if SH_DEGREE < 0
    for (int c = 0; dlooks && c < 3; ++c) dlooks[3 * i + c] = saturated(dcolor[c]);
#else
    double unit[3], inverse_length, dcentre[3];
    view_direction(cam, position, unit, inverse_length);
    const float x = float(unit[0]), y = float(unit[1]), z = float(unit[2]);
    float d[3];
    sh_color_backward<kShDegree>(x, y, z, looks + kLooks * i, dcolor, dlooks ? dlooks + kLooks * i : nullptr, d);
    if constexpr (kShDegree > 0) {
        const float along = x * d[0] + y * d[1] + z * d[2], across[3] = {d[0] - along * x, d[1] - along * y, d[2] - along * z};
        for (int j = 0; j < 3; ++j) {
            dcentre[j] = -double(across[j]) * inverse_length;
            dposition[j] -= dcentre[j];
        }
        centre_backward(cam, dcentre, grad);
    }
#endif
}

}  // namespace e4dgs
