// Primitives at one moment of their lives, forward and backward, one thread per primitive: see scene/motion/lifetimes/at_frame.py. All rows are
// contiguous.
#include "rotation.cuh"

namespace e4dgs {

constexpr float kSmallAngle = 1e-2f;  // squared half angle, below which differences of sine and cosine lose too many digits

// The turn by a rotation vector, of which `half` is one half: cos a, and sin a / a, where a is the half angle.
struct Turn {
    Vec half;
    float square, cosine, sinc;
    __device__ Quat quat() const { return {cosine, sinc * half}; }
};

__device__ __forceinline__ Turn turn_by(Vec half) {
    const float square = dot(half, half);
    if (square < kSmallAngle)
        return {half, square, 1.0f - square * (0.5f - square / 24.0f), 1.0f - square * (1.0f / 6.0f - square / 120.0f)};
    const float angle = sqrtf(square);
    float sine, cosine;
    sincosf(angle, &sine, &cosine);
    return {half, square, cosine, sine / angle};
}

// From the gradient of the quaternion to that of the half rotation vector.
__device__ __forceinline__ Vec unturn(const Turn& turn, Quat g) {
    // (cos a - sin a / a) / a^2, the derivative of sin a / a over a
    const float series = -1.0f / 3.0f + turn.square * (1.0f / 30.0f - turn.square / 840.0f);
    const float bend = turn.square < kSmallAngle ? series : (turn.cosine - turn.sinc) / turn.square;
    return turn.sinc * g.v + (bend * dot(g.v, turn.half) - turn.sinc * g.w) * turn.half;
}

__device__ __forceinline__ Vec mean_of(const float* points, int corners) {
    Vec sum{0.0f, 0.0f, 0.0f};
    for (int k = 0; k < corners; ++k) sum = sum + load_vec(points + 3 * k);
    return (1.0f / float(corners)) * sum;
}

}  // namespace e4dgs

using namespace e4dgs;

// points and moved [n, corners, 3]; quats and turned [n, 4], both null for convexes; opacities and shown [n]; times and log_spans [n] in
// frames; velocities and spins [n, 3] per frame; dynamic [n]. The frame is the number at frame_at, or `frame` if that is null.
extern "C" __global__ void __launch_bounds__(128)
    live(int n, int corners, const float* points, const float* quats, const float* opacities, const float* times, const float* log_spans,
         const float* velocities, const float* spins, const bool* dynamic, float frame, const float* frame_at, float* moved,
         float* turned, float* shown) {
    const int64 i = int64(blockIdx.x) * blockDim.x + threadIdx.x;
    if (i >= n) return;
    const float* from = points + 3 * corners * i;
    float* to = moved + 3 * corners * i;
    if (!dynamic[i]) {
        for (int k = 0; k < corners; ++k) store_vec(to + 3 * k, load_vec(from + 3 * k));
        if (quats) store_quat(turned + 4 * i, load_quat(quats + 4 * i));
        shown[i] = opacities[i];
        return;
    }
    const float age = (frame_at ? *frame_at : frame) - times[i], z = age * expf(-log_spans[i]);
    const Quat turn = turn_by(0.5f * age * load_vec(spins + 3 * i)).quat();
    const Vec drift = age * load_vec(velocities + 3 * i);
    const Vec mean = corners > 1 ? mean_of(from, corners) : Vec{0.0f, 0.0f, 0.0f};
    for (int k = 0; k < corners; ++k) {
        const Vec at = load_vec(from + 3 * k);
        store_vec(to + 3 * k, at + drift + (corners > 1 ? moved_by(turn, at - mean) : Vec{0.0f, 0.0f, 0.0f}));
    }
    if (quats) store_quat(turned + 4 * i, turn * load_quat(quats + 4 * i));
    shown[i] = opacities[i] * expf(-0.5f * z * z);
}

// g_moved, g_turned, g_shown: incoming gradients, each null if there is none. out_*: those of the inputs; out_quats is null as quats is.
extern "C" __global__ void __launch_bounds__(128)
    live_backward(int n, int corners, const float* points, const float* quats, const float* opacities, const float* times,
                  const float* log_spans, const float* velocities, const float* spins, const bool* dynamic, float frame,
                  const float* frame_at, const float* g_moved, const float* g_turned, const float* g_shown, float* out_points,
                  float* out_quats, float* out_opacities, float* out_times, float* out_log_spans, float* out_velocities,
                  float* out_spins) {
    const int64 i = int64(blockIdx.x) * blockDim.x + threadIdx.x;
    if (i >= n) return;
    const int64 first = corners * i;
    const float g = g_shown ? g_shown[i] : 0.0f;
    const Quat g_quat = quat_or_zero(g_turned, i);
    if (!dynamic[i]) {
        for (int k = 0; k < corners; ++k) store_vec(out_points + 3 * (first + k), vec_or_zero(g_moved, first + k));
        if (quats) store_quat(out_quats + 4 * i, g_quat);
        out_opacities[i] = g;
        out_times[i] = out_log_spans[i] = 0.0f;
        store_vec(out_velocities + 3 * i, {0.0f, 0.0f, 0.0f}), store_vec(out_spins + 3 * i, {0.0f, 0.0f, 0.0f});
        return;
    }
    const float age = (frame_at ? *frame_at : frame) - times[i];
    const float inverse = expf(-log_spans[i]), z = age * inverse, presence = expf(-0.5f * z * z);
    const Vec spin = load_vec(spins + 3 * i);
    const Turn turn = turn_by(0.5f * age * spin);
    const Quat q = turn.quat();
    Quat g_turn{0.0f, {0.0f, 0.0f, 0.0f}};
    Vec g_drift{0.0f, 0.0f, 0.0f}, g_turning{0.0f, 0.0f, 0.0f};  // sums over the corners
    if (corners > 1) {
        const Vec mean = mean_of(points + 3 * first, corners);
        for (int k = 0; k < corners; ++k) {
            const Vec at = load_vec(points + 3 * (first + k)), g_at = vec_or_zero(g_moved, first + k);
            g_turn = g_turn + unmoved(q, at - mean, g_at);
            g_turning = g_turning + moved_by(conjugate(q), g_at);
        }
    }
    const Vec shared = (1.0f / float(corners)) * g_turning;  // each corner is a part of the mean
    for (int k = 0; k < corners; ++k) {
        const Vec g_at = vec_or_zero(g_moved, first + k);
        g_drift = g_drift + g_at;
        store_vec(out_points + 3 * (first + k), corners > 1 ? g_at + moved_by(conjugate(q), g_at) - shared : g_at);
    }
    if (quats) {
        g_turn = g_turn + g_quat * conjugate(load_quat(quats + 4 * i));
        store_quat(out_quats + 4 * i, conjugate(q) * g_quat);
    }
    const Vec g_half = unturn(turn, g_turn);
    const float g_bell = g * opacities[i] * presence * z;
    out_opacities[i] = g * presence;
    out_log_spans[i] = g_bell * z;
    out_times[i] = g_bell * inverse - dot(g_drift, load_vec(velocities + 3 * i)) - 0.5f * dot(g_half, spin);
    store_vec(out_velocities + 3 * i, age * g_drift);
    store_vec(out_spins + 3 * i, 0.5f * age * g_half);
}
