#include "skinning.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>
#include <memory>
#include <numeric>
#include <vector>

#include "clones.h"
#include "flush.h"
#include "skinning_weights.h"

namespace e4dgs {
namespace {

constexpr int64_t kRange = 4096;  // positions per partial sum; fixed, so that sums do not depend on the number of threads
constexpr float kLeastNorm = 1e-6f;

typedef float Rigid __attribute__((vector_size(4 * kRigid)));

// Gradient sums of a node: rigid motion 16, falloff 1, hyper coordinates.
constexpr int kSums = 24;
enum { gFalloff = 16, gHyper = 17 };
static_assert(gHyper + kMostHyper <= kSums);

#define LOAD(vector, from) std::memcpy(&(vector), (from), sizeof(Rigid))
#define STORE(to, vector) std::memcpy((to), &(vector), sizeof(Rigid))

// +1, or -1 if the quaternion is on the opposite side from the first: q and -q are the same rotation, but would cancel in a sum.
inline float side_of(const float* rigid, const float* first) {
    const float *a = rigid + kQuat, *b = first + kQuat;
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3] < 0 ? -1.0f : 1.0f;
}

#define BOTH_SIDES(w, s) {w, w, w, w, w, w, w, w, w, w, w, w, s, s, s, s}

inline void product(const float* p, const float* q, float* out) {  // rotation by q, then by p
    out[0] = p[0] * q[0] - p[1] * q[1] - p[2] * q[2] - p[3] * q[3];
    out[1] = p[0] * q[1] + p[1] * q[0] + p[2] * q[3] - p[3] * q[2];
    out[2] = p[0] * q[2] - p[1] * q[3] + p[2] * q[0] + p[3] * q[1];
    out[3] = p[0] * q[3] + p[1] * q[2] - p[2] * q[1] + p[3] * q[0];
}

inline float inverse_norm(const float* q) { return 1.0f / std::max(std::sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]), kLeastNorm); }

E4DGS_CLONES void blend_block(const Skinning& in, const Frames& frames, const Weights& weights, const Block& block, float* blended) {
    for (int j = 0; j < block.count; ++j) {
        const int32_t* link = in.link + in.links * block.row[j];
        const float* first = frames.rigid.data() + size_t(link[0]) * kRigid;
        Rigid sum = {};
        for (int k = 0; k < in.links; ++k) {
            const float *r = frames.rigid.data() + size_t(link[k]) * kRigid, w = weights.value[k][j], s = w * side_of(r, first);
            const Rigid both = BOTH_SIDES(w, s);
            Rigid rigid;
            LOAD(rigid, r);
            sum += both * rigid;
        }
        STORE(blended + kRigid * j, sum);
    }
}

// The positions of the block are consecutive.
E4DGS_CLONES void apply_block(const Skinning& in, const Frames& frames, const float* blended, const Block& block, float* moved, float* turned) {
    for (int j = 0; j < block.count; ++j) {
        const int64_t i = block.row[0] + j;
        const float *m = blended + kRigid * j, inverse = inverse_norm(m + kQuat);
        float x[3], unit[4];
        for (int c = 0; c < 3; ++c) x[c] = in.rest[3 * i + c] - frames.origin[c];
        for (int c = 0; c < 3; ++c)
            moved[3 * i + c] = m[kR + 3 * c] * x[0] + m[kR + 3 * c + 1] * x[1] + m[kR + 3 * c + 2] * x[2] + m[kShift + c] + frames.origin[c];
        for (int c = 0; c < 4; ++c) unit[c] = m[kQuat + c] * inverse;
        product(unit, in.quats + 4 * i, turned + 4 * i);
    }
}

// From the gradients of the outputs to those of the blended motion [count, 16] and of the positions and quaternions themselves.
E4DGS_CLONES void unapply_block(const Skinning& in, const Frames& frames, const float* blended, const Block& block, const float* g_moved,
                                const float* g_turned, const SkinningGrad& out, float* back) {
    for (int j = 0; j < block.count; ++j) {
        const int64_t i = block.row[j];
        const float *m = blended + kRigid * j, *q = in.quats + 4 * i, *g = g_moved + 3 * i, inverse = inverse_norm(m + kQuat);
        float* to = back + kRigid * j;
        for (int c = 0; c < 3; ++c) {
            for (int a = 0; a < 3; ++a) to[kR + 3 * c + a] = g[c] * (in.rest[3 * i + a] - frames.origin[a]);
            to[kShift + c] = g[c];
            out.rest[3 * i + c] = m[kR + c] * g[0] + m[kR + 3 + c] * g[1] + m[kR + 6 + c] * g[2];
        }
        float unit[4], of_unit[4], along = 0;
        for (int c = 0; c < 4; ++c) unit[c] = m[kQuat + c] * inverse;
        const float conjugate[4] = {q[0], -q[1], -q[2], -q[3]}, turn_back[4] = {unit[0], -unit[1], -unit[2], -unit[3]};
        product(g_turned + 4 * i, conjugate, of_unit);
        product(turn_back, g_turned + 4 * i, out.quats + 4 * i);
        for (int c = 0; c < 4; ++c) along += of_unit[c] * unit[c];
        if (!(inverse < 1.0f / kLeastNorm)) along = 0;
        for (int c = 0; c < 4; ++c) to[kQuat + c] = (of_unit[c] - along * unit[c]) * inverse;
    }
}

E4DGS_CLONES void unblend_block(const Skinning& in, const Frames& frames, const Weights& weights, const float* back, const Block& block,
                                const SkinningGrad& out, float* totals) {
    alignas(64) float parts[kMostLinks][kRigid];
    for (int j = 0; j < block.count; ++j) {
        const int64_t i = block.row[j];
        const int32_t* link = in.link + in.links * i;
        const float* first = frames.rigid.data() + size_t(link[0]) * kRigid;
        float own[kMostLinks], mean = 0, g_hyper[kMostHyper] = {};
        Rigid g;
        LOAD(g, back + kRigid * j);
        for (int k = 0; k < in.links; ++k) {
            const float *r = frames.rigid.data() + size_t(link[k]) * kRigid, side = side_of(r, first), w = weights.value[k][j], s = w * side;
            float* total = totals + size_t(link[k]) * kSums;
            const Rigid both = BOTH_SIDES(w, s), sided = BOTH_SIDES(1.0f, side);
            Rigid rigid, sum;
            LOAD(rigid, r), LOAD(sum, total);
            sum += both * g;
            STORE(total, sum);
            const Rigid of_weight = sided * rigid * g;
            STORE(parts[k], of_weight);
        }
        for (int k = 0; k < in.links; ++k) {
            float* p = parts[k];
            for (int f = 0; f < 8; ++f) p[f] += p[f + 8];
            for (int f = 0; f < 4; ++f) p[f] += p[f + 4];
            own[k] = (p[0] + p[2]) + (p[1] + p[3]);
            mean += weights.value[k][j] * own[k];
        }
        for (int k = 0; k < in.links; ++k) {
            float* total = totals + size_t(link[k]) * kSums;
            const float of_exponent = weights.value[k][j] * (own[k] - mean), falloff = in.falloff[link[k]];
            total[gFalloff] -= of_exponent * weights.d2[k][j];
            for (int c = 0; c < in.hyper; ++c) {
                const float d = -2.0f * of_exponent * falloff * (in.rest_hyper[in.hyper * i + c] - in.home_hyper[in.hyper * link[k] + c]);
                g_hyper[c] += d;
                total[gHyper + c] -= d;
            }
        }
        for (int c = 0; c < in.hyper; ++c) out.rest_hyper[in.hyper * i + c] = g_hyper[c];
    }
}

// Fills `block` with the next positions that have a gradient, and returns where to go on. Most of those that the camera does not see have none.
int64_t with_gradient(const float* g_moved, const float* g_turned, int64_t next, int64_t end, Block& block) {
    for (; next < end && block.count < kBlock; ++next) {
        uint32_t found = 0;  // on the bits, so that NaN counts
        for (int c = 0; c < 3; ++c) found |= std::bit_cast<uint32_t>(g_moved[3 * next + c]);
        for (int c = 0; c < 4; ++c) found |= std::bit_cast<uint32_t>(g_turned[4 * next + c]);
        block.row[block.count] = next;
        block.count += (found & 0x7fffffffu) != 0;
    }
    return next;
}

// From sums over positions to the gradients of a node's own parameters.
void finish_node(const Skinning& in, const Frames& frames, int b, const double* sum, const SkinningGrad& out) {
    const float *q = in.turns + 4 * b, w = q[0], x = q[1], y = q[2], z = q[3], *home = &frames.place[size_t(b) * kPlace];
    double r[9];  // the translation contains -R home, so its gradient also reaches the rotation
    for (int c = 0; c < 3; ++c)
        for (int a = 0; a < 3; ++a) r[3 * c + a] = sum[kR + 3 * c + a] - sum[kShift + c] * home[a];
    const double g[4] = {2 * (-z * r[1] + y * r[2] + z * r[3] - x * r[5] - y * r[6] + x * r[7]),
                         2 * (y * r[1] + z * r[2] + y * r[3] - 2 * x * r[4] - w * r[5] + z * r[6] + w * r[7] - 2 * x * r[8]),
                         2 * (-2 * y * r[0] + x * r[1] + w * r[2] + x * r[3] + z * r[5] - w * r[6] + z * r[7] - 2 * y * r[8]),
                         2 * (-2 * z * r[0] - w * r[1] + x * r[2] + w * r[3] - 2 * z * r[4] + y * r[5] + x * r[6] + y * r[7])};
    for (int c = 0; c < 4; ++c) out.turns[4 * b + c] = float(g[c] + sum[kQuat + c]);
    for (int c = 0; c < 3; ++c) out.shifts[3 * b + c] = float(sum[kShift + c]);
    out.falloff[b] = float(sum[gFalloff]);
    for (int c = 0; c < in.hyper; ++c) out.home_hyper[in.hyper * b + c] = float(sum[gHyper + c]);
}

}  // namespace

void skin_forward(const Skinning& in, float* moved, float* turned, int threads) {
    const Frames frames = frames_of(in);
    const int64_t blocks = (in.n + kBlock - 1) / kBlock;
#pragma omp parallel num_threads(threads)
    {
        [[maybe_unused]] const FlushDenormals flush;
#pragma omp for schedule(static)
        for (int64_t k = 0; k < blocks; ++k) {
            Block block{int(std::min<int64_t>(kBlock, in.n - k * kBlock)), {}};
            std::iota(block.row, block.row + block.count, k * kBlock);
            Weights weights;
            alignas(64) float blended[kBlock * kRigid];
            weigh(in, frames, block, weights);
            blend_block(in, frames, weights, block, blended);
            apply_block(in, frames, blended, block, moved, turned);
        }
    }
}

void skin_backward(const Skinning& in, const float* g_moved, const float* g_turned, const SkinningGrad& out, int threads) {
    const Frames frames = frames_of(in);
    const size_t width = size_t(in.nodes) * kSums;
    std::vector<double> sums(width, 0.0);
    const int64_t ranges = (in.n + kRange - 1) / kRange;
    constexpr int64_t kTogether = 64;  // ranges whose totals are in memory at once
    const auto totals = std::make_unique_for_overwrite<float[]>(size_t(std::min(ranges, kTogether)) * width);
    for (int64_t first = 0; first < ranges; first += kTogether) {
        const int64_t last = std::min(ranges, first + kTogether);
#pragma omp parallel num_threads(threads)
        {
            [[maybe_unused]] const FlushDenormals flush;
#pragma omp for schedule(static)
            for (int64_t r = first; r < last; ++r) {
                float* mine = totals.get() + size_t(r - first) * width;
                std::fill(mine, mine + width, 0.0f);
                const int64_t begin = r * kRange, end = std::min(in.n, begin + kRange);
                std::fill(out.rest + 3 * begin, out.rest + 3 * end, 0.0f), std::fill(out.quats + 4 * begin, out.quats + 4 * end, 0.0f);
                std::fill(out.rest_hyper + in.hyper * begin, out.rest_hyper + in.hyper * end, 0.0f);
                for (int64_t next = begin; next < end;) {
                    Block block{0, {}};
                    next = with_gradient(g_moved, g_turned, next, end, block);
                    if (!block.count) break;
                    Weights weights;
                    alignas(64) float blended[kBlock * kRigid], back[kBlock * kRigid];
                    weigh(in, frames, block, weights);
                    blend_block(in, frames, weights, block, blended);
                    unapply_block(in, frames, blended, block, g_moved, g_turned, out, back);
                    unblend_block(in, frames, weights, back, block, out, mine);
                }
            }
#pragma omp for schedule(static)
            for (int64_t f = 0; f < int64_t(width); f += kSums)
                for (int64_t r = 0; r < last - first; ++r)
                    for (int64_t c = f; c < f + kSums; ++c) sums[size_t(c)] += double(totals[size_t(r) * width + size_t(c)]);
        }
    }
    for (int b = 0; b < in.nodes; ++b) finish_node(in, frames, b, &sums[size_t(b) * kSums], out);
}

}  // namespace e4dgs
