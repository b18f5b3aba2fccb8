// Primitives of one kind at one moment of their lives: they drift and turn steadily, and fade before and after.
#pragma once
#include <cstdint>

namespace e4dgs {

struct Lives {
    int64_t n, corners;        // primitives, and points of each: 1 for Gaussians
    const float* points;       // [n, corners, 3] at the middle of the life, world units
    const float* quats;        // [n, 4] w x y z of any norm; null for convexes
    const float* opacities;    // [n]
    const float* times;        // [n] frames: the middle of each life
    const float* log_spans;    // [n] ln of its standard deviation in frames
    const float* velocities;   // [n, 3] world units a frame
    const float* spins;        // [n, 3] rotation vectors, radians a frame
    const bool* dynamic;       // [n] the others stay as they are
    float frame;               // the moment
};

// [n, corners, 3], [n, 4] or null, [n]: outputs of the forward pass, or their gradients.
template <class T>
struct Shown {
    T *points, *quats, *opacities;
};

// Gradients, shaped like the fields of `Lives`; quats may be null.
struct LivesGrad {
    float *points, *quats, *opacities, *times, *log_spans, *velocities, *spins;
};

void lives_forward(const Lives& in, const Shown<float>& out, int threads);

// All of `out` is overwritten. Each primitive is on its own, so the number of threads does not matter.
void lives_backward(const Lives& in, const Shown<const float>& grad, const LivesGrad& out, int threads);

}  // namespace e4dgs
