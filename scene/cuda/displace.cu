// From the field's heads to displacements, forward and backward, one thread per point: see scene/motion/planes/displace.py. All rows are contiguous.
#include "device.cuh"

namespace e4dgs {

constexpr float kLeastNorm = 1e-6f;  // of a quaternion

struct Turn {
    float w, a[3];   // unit
    float inverse;   // 1 / norm of the quaternion before normalisation
    bool normal;     // whether that norm was at least kLeastNorm
    float arm[3];    // from the centre
    float twice[3];  // 2 a x arm
};

__device__ __forceinline__ void cross(const float* a, const float* b, float* out) {
    out[0] = a[1] * b[2] - a[2] * b[1], out[1] = a[2] * b[0] - a[0] * b[2], out[2] = a[0] * b[1] - a[1] * b[0];
}

__device__ __forceinline__ Turn turn_of(const float* head, const float* rest, const float* centre) {
    const float q[4] = {1.0f + head[3], head[4], head[5], head[6]};
    const float norm = sqrtf(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
    Turn turn;
    turn.normal = norm >= kLeastNorm;
    turn.inverse = 1.0f / (turn.normal ? norm : kLeastNorm);
    turn.w = q[0] * turn.inverse;
    for (int j = 0; j < 3; ++j) turn.a[j] = q[1 + j] * turn.inverse, turn.arm[j] = rest[j] - centre[j];
    cross(turn.a, turn.arm, turn.twice);
    for (int j = 0; j < 3; ++j) turn.twice[j] *= 2.0f;
    return turn;
}

}  // namespace e4dgs

using namespace e4dgs;

// heads [n, 10], rest [n, 3], centre [3]; dx [n, 3], dr [n, 4], ds [n, 3].
extern "C" __global__ void __launch_bounds__(128)
    displace(int n, const float* heads, const float* rest, const float* centre, float reach, float* dx, float* dr, float* ds) {
    const int64 i = int64(blockIdx.x) * blockDim.x + threadIdx.x;
    if (i >= n) return;
    const float* head = heads + 10 * i;
    const Turn turn = turn_of(head, rest + 3 * i, centre);
    float around[3];
    cross(turn.a, turn.twice, around);
    dr[4 * i] = turn.w;
    for (int j = 0; j < 3; ++j) {
        dx[3 * i + j] = turn.w * turn.twice[j] + around[j] + head[j] * reach;
        dr[4 * i + 1 + j] = turn.a[j];
        ds[3 * i + j] = head[7 + j];
    }
}

// g_dx [n, 3], g_dr [n, 4], g_ds [n, 3]: incoming gradients, each null if there is none. g_heads [n, 10]; g_rest [n, 3] may be null.
extern "C" __global__ void __launch_bounds__(128) displace_backward(int n, const float* heads, const float* rest, const float* centre, float reach,
                                                                    const float* g_dx, const float* g_dr, const float* g_ds, float* g_heads, float* g_rest) {
    const int64 i = int64(blockIdx.x) * blockDim.x + threadIdx.x;
    if (i >= n) return;
    const Turn turn = turn_of(heads + 10 * i, rest + 3 * i, centre);
    float g[3], g_twice[3], from_around[3], from_twice[3], q[4];
    for (int j = 0; j < 3; ++j) g[j] = g_dx ? g_dx[3 * i + j] : 0.0f;
    for (int j = 0; j < 4; ++j) q[j] = g_dr ? g_dr[4 * i + j] : 0.0f;
    cross(g, turn.a, g_twice);  // dx = w twice + a x twice + ..., twice = 2 a x arm
    for (int j = 0; j < 3; ++j) g_twice[j] += turn.w * g[j];
    cross(turn.twice, g, from_around);
    cross(turn.arm, g_twice, from_twice);
    for (int j = 0; j < 3; ++j) q[0] += g[j] * turn.twice[j], q[1 + j] += from_around[j] + 2.0f * from_twice[j];
    const float along = turn.normal ? q[0] * turn.w + q[1] * turn.a[0] + q[2] * turn.a[1] + q[3] * turn.a[2] : 0.0f;
    float* to = g_heads + 10 * i;
    to[3] = (q[0] - along * turn.w) * turn.inverse;
    for (int j = 0; j < 3; ++j) {
        to[j] = g[j] * reach;
        to[4 + j] = (q[1 + j] - along * turn.a[j]) * turn.inverse;
        to[7 + j] = g_ds ? g_ds[3 * i + j] : 0.0f;
    }
    if (!g_rest) return;
    float g_arm[3];
    cross(g_twice, turn.a, g_arm);
    for (int j = 0; j < 3; ++j) g_rest[3 * i + j] = 2.0f * g_arm[j];
}
