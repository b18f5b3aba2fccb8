// The camera's gradient from the primitives: summed over a block in a fixed order, one row of 16 per block. Features: CAMERA (1: it is
// needed).
#pragma once
#include "warp_sum.cuh"
//
#include "camera.h"

#if !defined(CAMERA)
#define CAMERA 0
#endif

namespace e4dgs {

constexpr int kBackThreads = 128;

#if CAMERA
using CameraPart = CameraGrad<double>;

__device__ inline CameraPart no_camera_part() {
    CameraPart part;
    part.fx = part.fy = part.cx = part.cy = 0.0;
    for (double& r : part.R) r = 0.0;
    for (double& t : part.t) t = 0.0;
    return part;
}

// rows [blocks, 16]: fx fy cx cy, then the 3x4 of cam_from_world. All threads of the block must call this.
__device__ inline void add_camera_parts(const CameraPart& part, double* rows) {
    __shared__ double warps[kBackThreads / 32][16];
    const int lane = int(threadIdx.x) % 32, warp = int(threadIdx.x) / 32;
    double v[16] = {part.fx, part.fy, part.cx, part.cy};
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) v[4 + 4 * i + j] = part.R[3 * i + j];
        v[4 + 4 * i + 3] = part.t[i];
    }
    const int mine = warp_total_of<16>(lane);
    const double total = warp_totals<16>(v, lane);
    if (mine >= 0) warps[warp][mine] = total;
    __syncthreads();
    if (threadIdx.x >= 16) return;
    double sum = 0.0;
    for (int w = 0; w < kBackThreads / 32; ++w) sum += warps[w][threadIdx.x];
    rows[16 * int64(blockIdx.x) + threadIdx.x] = sum;
}
#else
// Discards what is added to it.
struct Nothing {
    __device__ void operator+=(double) {}
    __device__ void operator-=(double) {}
};
struct Nothings {
    __device__ Nothing operator[](int) const { return {}; }
};
struct CameraPart {
    Nothing fx, fy, cx, cy;
    Nothings R, t;
};

__device__ inline CameraPart no_camera_part() { return {}; }
__device__ inline void add_camera_parts(const CameraPart&, double*) {}
#endif

}  // namespace e4dgs
