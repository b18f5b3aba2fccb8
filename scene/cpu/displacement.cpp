#include "displacement.h"

#include <algorithm>
#include <cmath>

#include "clones.h"

namespace e4dgs {
namespace {

constexpr float kLeastNorm = 1e-6f;  // of a quaternion
constexpr int64_t kRange = 2048;

struct Turn {
    float w, a[3];  // unit
    float inverse;  // 1 / norm of the quaternion before normalisation
    bool normal;    // whether that norm was at least kLeastNorm
    float twice[3]; // 2 a x arm
};

inline void cross(const float* a, const float* b, float* out) {
    out[0] = a[1] * b[2] - a[2] * b[1], out[1] = a[2] * b[0] - a[0] * b[2], out[2] = a[0] * b[1] - a[1] * b[0];
}

inline Turn turn_of(const float* head, const float* arm) {
    const float q[4] = {1.0f + head[3], head[4], head[5], head[6]};
    const float norm = std::sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
    Turn turn;
    turn.normal = norm >= kLeastNorm;
    turn.inverse = 1.0f / (turn.normal ? norm : kLeastNorm);
    turn.w = q[0] * turn.inverse;
    for (int j = 0; j < 3; ++j) turn.a[j] = q[1 + j] * turn.inverse;
    cross(turn.a, arm, turn.twice);
    for (float& t : turn.twice) t *= 2.0f;
    return turn;
}

E4DGS_CLONES void forward_range(const Displacing& in, int64_t begin, int64_t end, float* dx, float* dr, float* ds) {
    for (int64_t i = begin; i < end; ++i) {
        const float* head = in.heads + 10 * i;
        float arm[3], around[3];
        for (int j = 0; j < 3; ++j) arm[j] = in.rest[3 * i + j] - in.centre[j];
        const Turn turn = turn_of(head, arm);
        cross(turn.a, turn.twice, around);
        for (int j = 0; j < 3; ++j) {
            dx[3 * i + j] = turn.w * turn.twice[j] + around[j] + head[j] * in.reach;
            dr[4 * i + 1 + j] = turn.a[j];
            ds[3 * i + j] = head[7 + j];
        }
        dr[4 * i] = turn.w;
    }
}

E4DGS_CLONES void backward_range(const Displacing& in, int64_t begin, int64_t end, const float* g_dx, const float* g_dr, const float* g_ds,
                                 float* g_heads, float* g_rest) {
    const float none[4] = {0, 0, 0, 0};
    for (int64_t i = begin; i < end; ++i) {
        const float *head = in.heads + 10 * i, *g = g_dx ? g_dx + 3 * i : none, *g_turn = g_dr ? g_dr + 4 * i : none, *g_scale = g_ds ? g_ds + 3 * i : none;
        float arm[3], g_twice[3], from_around[3], from_twice[3], g_arm[3];
        for (int j = 0; j < 3; ++j) arm[j] = in.rest[3 * i + j] - in.centre[j];
        const Turn turn = turn_of(head, arm);
        cross(g, turn.a, g_twice);  // dx = w twice + a x twice + ..., twice = 2 a x arm
        for (int j = 0; j < 3; ++j) g_twice[j] += turn.w * g[j];
        cross(turn.twice, g, from_around);
        cross(arm, g_twice, from_twice);
        cross(g_twice, turn.a, g_arm);
        float q[4] = {g_turn[0] + g[0] * turn.twice[0] + g[1] * turn.twice[1] + g[2] * turn.twice[2], 0, 0, 0};
        for (int j = 0; j < 3; ++j) q[1 + j] = g_turn[1 + j] + from_around[j] + 2.0f * from_twice[j];
        const float along = turn.normal ? q[0] * turn.w + q[1] * turn.a[0] + q[2] * turn.a[1] + q[3] * turn.a[2] : 0.0f;
        float* to = g_heads + 10 * i;
        to[3] = (q[0] - along * turn.w) * turn.inverse;
        for (int j = 0; j < 3; ++j) {
            to[j] = g[j] * in.reach;
            to[4 + j] = (q[1 + j] - along * turn.a[j]) * turn.inverse;
            to[7 + j] = g_scale[j];
            if (g_rest) g_rest[3 * i + j] = 2.0f * g_arm[j];
        }
    }
}

}  // namespace

void displacement_forward(const Displacing& in, float* dx, float* dr, float* ds, int threads) {
    const int64_t ranges = (in.n + kRange - 1) / kRange;
#pragma omp parallel for schedule(static) num_threads(threads)
    for (int64_t r = 0; r < ranges; ++r) forward_range(in, r * kRange, std::min(in.n, (r + 1) * kRange), dx, dr, ds);
}

void displacement_backward(const Displacing& in, const float* g_dx, const float* g_dr, const float* g_ds, float* g_heads, float* g_rest, int threads) {
    const int64_t ranges = (in.n + kRange - 1) / kRange;
#pragma omp parallel for schedule(static) num_threads(threads)
    for (int64_t r = 0; r < ranges; ++r) backward_range(in, r * kRange, std::min(in.n, (r + 1) * kRange), g_dx, g_dr, g_ds, g_heads, g_rest);
}

}  // namespace e4dgs
