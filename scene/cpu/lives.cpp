#include "lives.h"

#include <cmath>
#include <cstring>

#include "flush.h"

namespace e4dgs {
namespace {

constexpr float kSmallAngle = 1e-2f;  // squared half angle, below which differences of sine and cosine lose too many digits

struct Vec {
    float x, y, z;
};
inline Vec operator+(Vec a, Vec b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
inline Vec operator-(Vec a, Vec b) { return {a.x - b.x, a.y - b.y, a.z - b.z}; }
inline Vec operator*(float s, Vec a) { return {s * a.x, s * a.y, s * a.z}; }
inline float dot(Vec a, Vec b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
inline Vec cross(Vec a, Vec b) { return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x}; }
inline Vec load(const float* p) { return {p[0], p[1], p[2]}; }
inline void store(float* p, Vec a) { p[0] = a.x, p[1] = a.y, p[2] = a.z; }

struct Quat {
    float w;
    Vec v;
};
inline Quat operator*(Quat a, Quat b) { return {a.w * b.w - dot(a.v, b.v), a.w * b.v + b.w * a.v + cross(a.v, b.v)}; }
inline Quat conjugate(Quat a) { return {a.w, -1.0f * a.v}; }
inline Quat load_quat(const float* p) { return {p[0], load(p + 1)}; }
inline void store_quat(float* p, Quat q) { p[0] = q.w, store(p + 1, q.v); }

// The turn by half the rotation vector's length on each side: cos a, and sin a / a, where a is the half angle.
struct Turn {
    Vec half;
    float square, cosine, sinc;
    Quat quat() const { return {cosine, sinc * half}; }
};

inline Turn turn_by(Vec half) {
    const float square = dot(half, half);
    if (square < kSmallAngle) return {half, square, 1 - square * (0.5f - square / 24), 1 - square * (1.0f / 6 - square / 120)};
    const float angle = std::sqrt(square);
    return {half, square, std::cos(angle), std::sin(angle) / angle};
}

// From the gradient of the quaternion to that of the half rotation vector.
inline Vec unturn(const Turn& turn, Quat g) {
    // (cos a - sin a / a) / a^2, the derivative of sin a / a over a
    const float bend = turn.square < kSmallAngle ? -1.0f / 3 + turn.square * (1.0f / 30 - turn.square / 840) : (turn.cosine - turn.sinc) / turn.square;
    return turn.sinc * g.v + (bend * dot(g.v, turn.half) - turn.sinc * g.w) * turn.half;
}

inline Vec rotate(Quat q, Vec a) {
    const Vec twice = 2.0f * cross(q.v, a);
    return a + q.w * twice + cross(q.v, twice);
}

inline Vec centre_of(const float* points, int64_t corners) {
    Vec sum{0, 0, 0};
    for (int64_t k = 0; k < corners; ++k) sum = sum + load(points + 3 * k);
    return (1.0f / float(corners)) * sum;
}

inline float presence_of(float age, float log_span) {
    const float z = age * std::exp(-log_span);
    return std::exp(-0.5f * z * z);
}

inline void forward_one(const Lives& in, const Shown<float>& out, int64_t i) {
    const int64_t first = 3 * in.corners * i;
    if (!in.dynamic[i]) {
        std::memcpy(out.points + first, in.points + first, 3 * size_t(in.corners) * sizeof(float));
        if (in.quats) std::memcpy(out.quats + 4 * i, in.quats + 4 * i, 4 * sizeof(float));
        out.opacities[i] = in.opacities[i];
        return;
    }
    const float age = in.frame - in.times[i];
    const Turn turn = turn_by(0.5f * age * load(in.spins + 3 * i));
    const Vec drift = age * load(in.velocities + 3 * i);
    if (in.corners == 1) {
        store(out.points + first, load(in.points + first) + drift);
    } else {
        const Vec centre = centre_of(in.points + first, in.corners);
        for (int64_t k = 0; k < in.corners; ++k)
            store(out.points + first + 3 * k, centre + drift + rotate(turn.quat(), load(in.points + first + 3 * k) - centre));
    }
    if (in.quats) store_quat(out.quats + 4 * i, turn.quat() * load_quat(in.quats + 4 * i));
    out.opacities[i] = in.opacities[i] * presence_of(age, in.log_spans[i]);
}

// The gradients of one convex's corners, and what they add to the gradient of its turn.
inline Quat unturn_corners(const Lives& in, Quat turn, int64_t i, const float* grad, float* out) {
    const int64_t first = 3 * in.corners * i;
    const Vec centre = centre_of(in.points + first, in.corners);
    Quat g_turn{0, {0, 0, 0}};
    Vec shared{0, 0, 0};
    for (int64_t k = 0; k < in.corners; ++k) {
        const Vec g = load(grad + first + 3 * k), arm = load(in.points + first + 3 * k) - centre, u = turn.v;
        g_turn.w += 2 * dot(g, cross(u, arm));
        g_turn.v = g_turn.v + 2 * turn.w * cross(arm, g) + 2.0f * (dot(g, u) * arm + dot(u, arm) * g - 2 * dot(g, arm) * u);
        const Vec of_arm = rotate(conjugate(turn), g);
        store(out + first + 3 * k, of_arm);
        shared = shared + (g - of_arm);
    }
    shared = (1.0f / float(in.corners)) * shared;
    for (int64_t k = 0; k < in.corners; ++k) store(out + first + 3 * k, load(out + first + 3 * k) + shared);
    return g_turn;
}

inline void backward_one(const Lives& in, const Shown<const float>& grad, const LivesGrad& out, int64_t i) {
    const int64_t first = 3 * in.corners * i;
    if (!in.dynamic[i]) {
        std::memcpy(out.points + first, grad.points + first, 3 * size_t(in.corners) * sizeof(float));
        if (in.quats) std::memcpy(out.quats + 4 * i, grad.quats + 4 * i, 4 * sizeof(float));
        out.opacities[i] = grad.opacities[i];
        out.times[i] = out.log_spans[i] = 0;
        store(out.velocities + 3 * i, {0, 0, 0}), store(out.spins + 3 * i, {0, 0, 0});
        return;
    }
    const float age = in.frame - in.times[i], presence = presence_of(age, in.log_spans[i]), inverse = std::exp(-in.log_spans[i]);
    const Vec spin = load(in.spins + 3 * i), velocity = load(in.velocities + 3 * i);
    const Turn turn = turn_by(0.5f * age * spin);
    Quat g_turn{0, {0, 0, 0}};
    if (in.corners == 1)
        store(out.points + first, load(grad.points + first));
    else
        g_turn = unturn_corners(in, turn.quat(), i, grad.points, out.points);
    if (in.quats) {
        const Quat g = load_quat(grad.quats + 4 * i);
        const Quat of_turn = g * conjugate(load_quat(in.quats + 4 * i));
        g_turn = {g_turn.w + of_turn.w, g_turn.v + of_turn.v};
        store_quat(out.quats + 4 * i, conjugate(turn.quat()) * g);
    }
    Vec g_drift{0, 0, 0};
    for (int64_t k = 0; k < in.corners; ++k) g_drift = g_drift + load(grad.points + first + 3 * k);
    const Vec g_half = unturn(turn, g_turn);
    const float z = age * inverse, g_bell = grad.opacities[i] * in.opacities[i] * presence * z;
    out.opacities[i] = grad.opacities[i] * presence;
    out.log_spans[i] = g_bell * z;
    out.times[i] = g_bell * inverse - dot(g_drift, velocity) - 0.5f * dot(g_half, spin);
    store(out.velocities + 3 * i, age * g_drift);
    store(out.spins + 3 * i, 0.5f * age * g_half);
}

}  // namespace

void lives_forward(const Lives& in, const Shown<float>& out, int threads) {
#pragma omp parallel num_threads(threads)
    {
        const FlushDenormals flush;
#pragma omp for
        for (int64_t i = 0; i < in.n; ++i) forward_one(in, out, i);
    }
}

void lives_backward(const Lives& in, const Shown<const float>& grad, const LivesGrad& out, int threads) {
#pragma omp parallel num_threads(threads)
    {
        const FlushDenormals flush;
#pragma omp for
        for (int64_t i = 0; i < in.n; ++i) backward_one(in, grad, out, i);
    }
}

}  // namespace e4dgs
