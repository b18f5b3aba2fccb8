// Applies the field's ten outputs to a position: a rotation about the box's centre, a translation, and a change of the log scales.
#pragma once
#include <cstdint>

namespace e4dgs {

struct Displacing {
    const float* heads;  // [n, 10]: translation 3 (in units of `reach`), rotation 4 (added to the identity), log scales 3
    const float* rest;   // [n, 3] world units
    int64_t n;
    float centre[3], reach;
};

// dx [n, 3], dr [n, 4] unit quaternion, ds [n, 3].
void displacement_forward(const Displacing& in, float* dx, float* dr, float* ds, int threads);

// From the gradients of the three outputs (each may be null) to those of heads and rest (g_rest may be null); both are overwritten.
void displacement_backward(const Displacing& in, const float* g_dx, const float* g_dr, const float* g_ds, float* g_heads, float* g_rest, int threads);

}  // namespace e4dgs
