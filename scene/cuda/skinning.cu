// Points and their quaternions as nodes carry them, forward and backward, one thread per point: see scene/motion/nodes/skinning.py. All rows are
// contiguous. Gradients of nodes are sums over points: by atomic additions, or, for a fixed order, as rows that sum_links.cu adds.
// Compile-time features: see nodes.cuh.
#include "nodes.cuh"
#include "quads.cuh"
#include "rotation.cuh"
#include "warp_sum.cuh"

namespace e4dgs {

constexpr float kLeastNorm = 1e-6f;  // of a blended quaternion
constexpr int kMany = 8;             // lanes with a node in common, from which on they are summed over the warp and added once

struct Nodes {
    const float *home, *home_hyper, *falloff, *turns, *shifts;
};

// A point, and how its nodes share it.
struct Carried {
    Vec at;
    float beside[kHyper];
    int node[LINKS];
    float weight[LINKS], square[LINKS];  // square: distance^2
};

__device__ __forceinline__ Carried carried(const Nodes& nodes, const float* points, const float* hyper, const int* link, int64 i) {
    Carried point;
    point.at = load_vec(points + 3 * i);
#pragma unroll
    for (int c = 0; c < HYPER; ++c) point.beside[c] = hyper[HYPER * i + c];
    float most = -3.4028234663852886e38f, total = 0.0f;
#pragma unroll
    for (int k = 0; k < LINKS; ++k) {
        const int b = point.node[k] = link[LINKS * i + k];
        const Vec arm = point.at - load_vec(nodes.home + 3 * b);
        point.square[k] = dot(arm, arm);
#pragma unroll
        for (int c = 0; c < HYPER; ++c) {
            const float d = point.beside[c] - nodes.home_hyper[HYPER * b + c];
            point.square[k] += d * d;
        }
        point.weight[k] = -nodes.falloff[b] * point.square[k];
        most = fmaxf(most, point.weight[k]);
    }
#pragma unroll
    for (int k = 0; k < LINKS; ++k) total += point.weight[k] = expf(point.weight[k] - most);
#pragma unroll
    for (int k = 0; k < LINKS; ++k) point.weight[k] /= total;
    return point;
}

// +1, or -1 if the quaternion is on the opposite side from the first: q and -q are the same rotation, but would cancel in a sum.
__device__ __forceinline__ float side_of(Quat q, Quat first) { return dot(q, first) < 0.0f ? -1.0f : 1.0f; }

// The weighted sum of the turns of a point's nodes.
__device__ __forceinline__ Quat blend(const Nodes& nodes, const Carried& point) {
    const Quat first = load_quat(nodes.turns + 4 * point.node[0]);
    Quat sum{0.0f, {0.0f, 0.0f, 0.0f}};
#pragma unroll
    for (int k = 0; k < LINKS; ++k) {
        const Quat turn = load_quat(nodes.turns + 4 * point.node[k]);
        sum = sum + point.weight[k] * side_of(turn, first) * turn;
    }
    return sum;
}

__device__ __forceinline__ float4 quad_of(const float* row) { return make_float4(row[0], row[1], row[2], row[3]); }

// Adds the row of each lane to sums[node]; a node of -1 has none. All lanes of the warp must call it.
__device__ __forceinline__ void add_row(const float* row, int node, float* sums) {
    const int lane = int(threadIdx.x) % 32;
    const unsigned alike = __match_any_sync(kAllLanes, node);
    const bool many = node >= 0 && __popc(alike) >= kMany;
    if (node >= 0 && !many)
#pragma unroll
        for (int c = 0; c < kRow; c += 4) add_quad(sums + int64(node) * kRow + c, quad_of(row + c));
    for (unsigned left = __ballot_sync(kAllLanes, many); left;) {
        const int leader = __ffs(int(left)) - 1, common = __shfl_sync(kAllLanes, node, leader);
        left &= ~__shfl_sync(kAllLanes, alike, leader);
        float part[kRow];
#pragma unroll
        for (int c = 0; c < kRow; ++c) part[c] = node == common ? row[c] : 0.0f;
        const float total = warp_totals<kRow>(part, lane);
        const int column = warp_total_of<kRow>(lane);
        if (column >= 0) atomicAdd(sums + int64(common) * kRow + column, total);
    }
}

__device__ __forceinline__ bool any_bits(Vec g) { return (__float_as_uint(g.x) | __float_as_uint(g.y) | __float_as_uint(g.z)) << 1; }

}  // namespace e4dgs

using namespace e4dgs;

// points [n, 3], quats [n, 4], hyper [n, HYPER], link [n, LINKS]; of each node home [3], home_hyper [HYPER], falloff, turns [4], shifts
// [3]. moved [n, 3], turned [n, 4].
extern "C" __global__ void __launch_bounds__(kNodeThreads)
    skin(int n, const float* points, const float* quats, const float* hyper, const int* link, const float* home, const float* home_hyper,
         const float* falloff, const float* turns, const float* shifts, float* moved, float* turned) {
    const int64 i = int64(blockIdx.x) * blockDim.x + threadIdx.x;
    if (i >= n) return;
    const Nodes nodes{home, home_hyper, falloff, turns, shifts};
    const Carried point = carried(nodes, points, hyper, link, i);
    Vec way{0.0f, 0.0f, 0.0f};
#pragma unroll
    for (int k = 0; k < LINKS; ++k) {
        const int b = point.node[k];
        way = way + point.weight[k] * (moved_by(load_quat(turns + 4 * b), point.at - load_vec(home + 3 * b)) + load_vec(shifts + 3 * b));
    }
    const Quat turn = blend(nodes, point);
    store_vec(moved + 3 * i, point.at + way);
    store_quat(turned + 4 * i, 1.0f / fmaxf(sqrtf(dot(turn, turn)), kLeastNorm) * turn * load_quat(quats + 4 * i));
}

// g_moved, g_turned: incoming gradients, each null if there is none. out_*: those of the points. The nodes' are added to sums [nodes,
// kRow], or, if rows [n, LINKS, kRow] is not null, what each point adds to each of its nodes is written there.
extern "C" __global__ void __launch_bounds__(kNodeThreads)
    skin_backward(int n, const float* points, const float* quats, const float* hyper, const int* link, const float* home,
                  const float* home_hyper, const float* falloff, const float* turns, const float* shifts, const float* g_moved,
                  const float* g_turned, float* out_points, float* out_quats, float* out_hyper, float* sums, float* rows) {
    const int64 i = int64(blockIdx.x) * blockDim.x + threadIdx.x;
    const Nodes nodes{home, home_hyper, falloff, turns, shifts};
    Vec g{0.0f, 0.0f, 0.0f}, g_at = g;
    Quat g_quat{0.0f, {0.0f, 0.0f, 0.0f}}, g_blended = g_quat, first = g_quat;
    float g_beside[kHyper] = {};
    float of_exponent[LINKS] = {};
    Carried point = {};
    if (i < n) g = vec_or_zero(g_moved, i), g_quat = quat_or_zero(g_turned, i);
    // Most points that the camera does not see have no gradient. On the bits, so that NaN counts.
    const bool active = any_bits(g) || any_bits(g_quat.v) || any_bits({g_quat.w, 0.0f, 0.0f});
    if (active) {
        point = carried(nodes, points, hyper, link, i);
        first = load_quat(turns + 4 * point.node[0]);
        const Quat blended = blend(nodes, point);
        const float norm = sqrtf(dot(blended, blended)), inverse = 1.0f / fmaxf(norm, kLeastNorm);
        const Quat unit = inverse * blended, g_unit = g_quat * conjugate(load_quat(quats + 4 * i));
        g_blended = inverse * (norm >= kLeastNorm ? g_unit - dot(g_unit, unit) * unit : g_unit);
        g_quat = conjugate(unit) * g_quat;
        g_at = g;
        float mean = 0.0f;
#pragma unroll
        for (int k = 0; k < LINKS; ++k) {
            const int b = point.node[k];
            const Quat turn = load_quat(turns + 4 * b);
            const Vec way = moved_by(turn, point.at - load_vec(home + 3 * b)) + load_vec(shifts + 3 * b);
            of_exponent[k] = dot(g, way) + side_of(turn, first) * dot(g_blended, turn);
            // Relative to the first. It weighs most, and would lose digits when the mean is taken away.
            if (k) of_exponent[k] -= of_exponent[0], mean += point.weight[k] * of_exponent[k];
            g_at = g_at + point.weight[k] * moved_by(conjugate(turn), g);
        }
#pragma unroll
        for (int k = 0; k < LINKS; ++k) of_exponent[k] = point.weight[k] * ((k ? of_exponent[k] : 0.0f) - mean);
    }
#pragma unroll
    for (int k = 0; k < LINKS; ++k) {
        float row[kRow] = {};
        if (active) {
            const int b = point.node[k];
            const Quat turn = load_quat(turns + 4 * b);
            const Quat of_turn = unmoved(turn, point.at - load_vec(home + 3 * b), g) + side_of(turn, first) * g_blended;
            store_vec(row, point.weight[k] * g);
            row[3] = -of_exponent[k] * point.square[k];
            store_quat(row + 4, point.weight[k] * of_turn);
#pragma unroll
            for (int c = 0; c < HYPER; ++c) {
                row[8 + c] = 2.0f * of_exponent[k] * falloff[b] * (point.beside[c] - home_hyper[HYPER * b + c]);
                g_beside[c] -= row[8 + c];
            }
        }
        if (!rows) {
            add_row(row, active ? point.node[k] : -1, sums);
        } else if (i < n) {
#pragma unroll
            for (int c = 0; c < kRow; c += 4) store_quad(rows + (i * LINKS + k) * kRow + c, quad_of(row + c));
        }
    }
    if (i >= n) return;
    store_vec(out_points + 3 * i, g_at);
    store_quat(out_quats + 4 * i, g_quat);
#pragma unroll
    for (int c = 0; c < HYPER; ++c) out_hyper[HYPER * i + c] = g_beside[c];
}
