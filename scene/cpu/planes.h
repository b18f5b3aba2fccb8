// Six-plane lookup at one time: bilinear on xy, xz, yz and linear on the three time planes collapsed at t.
#pragma once
#include <cstdint>

namespace e4dgs {

// One resolution level. space [3,R,R,C] (xy, xz, yz; first coordinate varies fastest), time [3,T,R,C] (xt, yt, zt).
struct PlaneLevel {
    const float* space;
    const float* time;
    int resolution;
    int times;
    int channels;
};

// u [n,3] in [0,1]; t in [0,1]; out [n,stride], features of this level at column `offset`.
void planes_forward(const PlaneLevel& level, const float* u, int64_t n, float t, float* out, int64_t stride, int64_t offset, int threads);

// grad [n,stride] of the loss with respect to `out`; adds into grad_space and grad_time (shapes of the planes).
// Bit-equal for any number of threads: each plane is scattered by one thread, points in order.
void planes_backward(const PlaneLevel& level, const float* u, int64_t n, float t, const float* grad, int64_t stride, int64_t offset,
                     float* grad_space, float* grad_time, int threads);

}  // namespace e4dgs
