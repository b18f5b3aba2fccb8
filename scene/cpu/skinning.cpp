#include "skinning.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <limits>
#include <vector>

#include "clones.h"

namespace e4dgs {
namespace {

constexpr int kBlock = 64;        // positions that go through together, field by field
constexpr int64_t kRange = 1024;  // positions of one sum; fixed, so that sums do not depend on the threads
constexpr float kLeastNorm = 1e-6f;

// What a node gives each of its positions: rotation matrix 9, home 3, home + shift 3, quaternion 4, falloff 1, hyper 4.
enum { kR = 0, kHome = 9, kEnd = 12, kQuat = 15, kFalloff = 19, kHyper = 20, kRecord = 24 };
// What comes back: of the rotation matrix 9, shift 3, quaternion 4, falloff 1, hyper 4.
enum { gR = 0, gShift = 9, gQuat = 12, gFalloff = 16, gHyper = 17, kSums = 24 };

inline float exp_of(float x) {  // x <= 0; relative error below 2e-7
    x = std::max(x, -80.0f) * 1.44269504f;
    const float whole = std::floor(x + 0.5f), f = (x - whole) * 0.69314718f;
    float p = 1.0f / 720.0f;
    p = p * f + 1.0f / 120.0f, p = p * f + 1.0f / 24.0f, p = p * f + 1.0f / 6.0f, p = p * f + 0.5f, p = p * f + 1.0f, p = p * f + 1.0f;
    return p * std::bit_cast<float>((int32_t(whole) + 127) << 23);
}

std::vector<float> records_of(const Skinning& in) {
    std::vector<float> records(size_t(in.nodes) * kRecord, 0.0f);
    for (int b = 0; b < in.nodes; ++b) {
        float* r = &records[size_t(b) * kRecord];
        const float *q = in.turns + 4 * b, w = q[0], x = q[1], y = q[2], z = q[3];
        // The rotation of a unit quaternion as v + 2 w (a x v) + 2 a x (a x v).
        const float matrix[9] = {1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y), 2 * (x * y + w * z), 1 - 2 * (x * x + z * z),
                                 2 * (y * z - w * x), 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)};
        std::copy(matrix, matrix + 9, r + kR);
        for (int j = 0; j < 3; ++j) r[kHome + j] = in.home[3 * b + j], r[kEnd + j] = in.home[3 * b + j] + in.shifts[3 * b + j];
        std::copy(q, q + 4, r + kQuat);
        r[kFalloff] = in.falloff[b];
        for (int j = 0; j < in.hyper; ++j) r[kHyper + j] = in.home_hyper[in.hyper * b + j];
    }
    return records;
}

// Of up to kBlock positions: all they need, one field after another.
struct Block {
    float x[3][kBlock], h[kMostHyper][kBlock];
    float node[kMostLinks][kRecord][kBlock];
    float d2[kMostLinks][kBlock], weight[kMostLinks][kBlock], sign[kMostLinks][kBlock];
    float moved[3][kBlock], blend[4][kBlock], inverse[kBlock];
};

E4DGS_CLONES void load_and_weigh(const Skinning& in, const float* records, int64_t begin, int count, Block& b) {
    for (int j = 0; j < kBlock; ++j) {
        const int64_t i = begin + std::min(j, count - 1);  // the last one again where the block is not full
        for (int c = 0; c < 3; ++c) b.x[c][j] = in.rest[3 * i + c];
        for (int c = 0; c < in.hyper; ++c) b.h[c][j] = in.rest_hyper[in.hyper * i + c];
        for (int k = 0; k < in.links; ++k) {
            const float* r = records + size_t(in.link[in.links * i + k]) * kRecord;
            for (int f = 0; f < kRecord; ++f) b.node[k][f][j] = r[f];
        }
    }
    float best[kBlock], total[kBlock];
    for (int j = 0; j < kBlock; ++j) best[j] = -std::numeric_limits<float>::max(), total[j] = 0;
    for (int k = 0; k < in.links; ++k) {
        const auto& node = b.node[k];
        for (int j = 0; j < kBlock; ++j) {
            const float dx = b.x[0][j] - node[kHome][j], dy = b.x[1][j] - node[kHome + 1][j], dz = b.x[2][j] - node[kHome + 2][j];
            b.d2[k][j] = dx * dx + dy * dy + dz * dz;
        }
        for (int c = 0; c < in.hyper; ++c)
            for (int j = 0; j < kBlock; ++j) {
                const float d = b.h[c][j] - node[kHyper + c][j];
                b.d2[k][j] += d * d;
            }
        for (int j = 0; j < kBlock; ++j) {
            b.weight[k][j] = -b.d2[k][j] * node[kFalloff][j];
            best[j] = std::max(best[j], b.weight[k][j]);
        }
    }
    for (int k = 0; k < in.links; ++k)
        for (int j = 0; j < kBlock; ++j) {
            b.weight[k][j] = exp_of(b.weight[k][j] - best[j]);
            total[j] += b.weight[k][j];
        }
    for (int j = 0; j < kBlock; ++j) total[j] = 1.0f / total[j];
    for (int c = 0; c < 3; ++c)
        for (int j = 0; j < kBlock; ++j) b.moved[c][j] = 0;
    for (int c = 0; c < 4; ++c)
        for (int j = 0; j < kBlock; ++j) b.blend[c][j] = 0;
    for (int k = 0; k < in.links; ++k) {
        const auto &node = b.node[k], &first = b.node[0];
        for (int j = 0; j < kBlock; ++j) {
            b.weight[k][j] *= total[j];
            float along = 0;  // q and -q turn alike, their sum does not: all on the side of the first
            for (int c = 0; c < 4; ++c) along += node[kQuat + c][j] * first[kQuat + c][j];
            b.sign[k][j] = along < 0 ? -1.0f : 1.0f;
            const float w = b.weight[k][j], s = w * b.sign[k][j];
            const float ax = b.x[0][j] - node[kHome][j], ay = b.x[1][j] - node[kHome + 1][j], az = b.x[2][j] - node[kHome + 2][j];
            for (int c = 0; c < 3; ++c)
                b.moved[c][j] += w * (node[kR + 3 * c][j] * ax + node[kR + 3 * c + 1][j] * ay + node[kR + 3 * c + 2][j] * az + node[kEnd + c][j]);
            for (int c = 0; c < 4; ++c) b.blend[c][j] += s * node[kQuat + c][j];
        }
    }
    for (int j = 0; j < kBlock; ++j) {
        const float norm = std::sqrt(b.blend[0][j] * b.blend[0][j] + b.blend[1][j] * b.blend[1][j] + b.blend[2][j] * b.blend[2][j] + b.blend[3][j] * b.blend[3][j]);
        b.inverse[j] = 1.0f / std::max(norm, kLeastNorm);
    }
}

inline void product(const float* p, const float* q, float* out) {  // turning by q, then by p
    out[0] = p[0] * q[0] - p[1] * q[1] - p[2] * q[2] - p[3] * q[3];
    out[1] = p[0] * q[1] + p[1] * q[0] + p[2] * q[3] - p[3] * q[2];
    out[2] = p[0] * q[2] - p[1] * q[3] + p[2] * q[0] + p[3] * q[1];
    out[3] = p[0] * q[3] + p[1] * q[2] - p[2] * q[1] + p[3] * q[0];
}

void forward_block(const Skinning& in, const float* records, int64_t begin, int count, Block& b, float* moved, float* turned) {
    load_and_weigh(in, records, begin, count, b);
    for (int j = 0; j < count; ++j) {
        const int64_t i = begin + j;
        for (int c = 0; c < 3; ++c) moved[3 * i + c] = b.moved[c][j];
        const float unit[4] = {b.blend[0][j] * b.inverse[j], b.blend[1][j] * b.inverse[j], b.blend[2][j] * b.inverse[j], b.blend[3][j] * b.inverse[j]};
        if (in.quats)
            product(unit, in.quats + 4 * i, turned + 4 * i);
        else
            std::copy(unit, unit + 4, turned + 4 * i);
    }
}

// Gradients of one block. `back` [links][kBlock][kSums] holds what goes to the nodes.
struct Back {
    float g[3][kBlock], u[4][kBlock];  // of the moved position; of the sum of quaternions
    float own[kMostLinks][kBlock];     // of each weight
    float x[3][kBlock], h[kMostHyper][kBlock];
    float sums[kMostLinks][kSums][kBlock];
};

E4DGS_CLONES void back_through_weights(const Skinning& in, const Block& b, Back& back) {
    float mean[kBlock];
    for (int j = 0; j < kBlock; ++j) mean[j] = 0;
    for (int c = 0; c < 3; ++c)
        for (int j = 0; j < kBlock; ++j) back.x[c][j] = 0;
    for (int c = 0; c < in.hyper; ++c)
        for (int j = 0; j < kBlock; ++j) back.h[c][j] = 0;
    for (int k = 0; k < in.links; ++k) {
        const auto& node = b.node[k];
        auto& sums = back.sums[k];
        for (int j = 0; j < kBlock; ++j) {
            const float w = b.weight[k][j], sign = b.sign[k][j];
            const float arm[3] = {b.x[0][j] - node[kHome][j], b.x[1][j] - node[kHome + 1][j], b.x[2][j] - node[kHome + 2][j]};
            float of_weight = 0;
            for (int c = 0; c < 3; ++c) {
                const float g = back.g[c][j], wg = w * g;
                float at = node[kEnd + c][j];
                for (int a = 0; a < 3; ++a) {
                    at += node[kR + 3 * c + a][j] * arm[a];
                    sums[gR + 3 * c + a][j] = wg * arm[a];
                    back.x[a][j] += wg * node[kR + 3 * c + a][j];
                }
                sums[gShift + c][j] = wg;
                of_weight += g * at;
            }
            for (int c = 0; c < 4; ++c) {
                of_weight += sign * back.u[c][j] * node[kQuat + c][j];
                sums[gQuat + c][j] = w * sign * back.u[c][j];
            }
            back.own[k][j] = of_weight;
            mean[j] += w * of_weight;
        }
    }
    for (int k = 0; k < in.links; ++k) {
        const auto& node = b.node[k];
        auto& sums = back.sums[k];
        for (int j = 0; j < kBlock; ++j) {
            const float of_exponent = b.weight[k][j] * (back.own[k][j] - mean[j]);
            sums[gFalloff][j] = -of_exponent * b.d2[k][j];
            back.own[k][j] = -2.0f * of_exponent * node[kFalloff][j];
        }
        for (int c = 0; c < in.hyper; ++c)
            for (int j = 0; j < kBlock; ++j) {
                const float g = back.own[k][j] * (b.h[c][j] - node[kHyper + c][j]);
                back.h[c][j] += g;
                sums[gHyper + c][j] = -g;
            }
    }
}

E4DGS_CLONES void add_to_nodes(const Skinning& in, int64_t begin, int count, const Back& back, float* totals) {
    for (int k = 0; k < in.links; ++k)
        for (int j = 0; j < count; ++j) {
            float* total = totals + size_t(in.link[in.links * (begin + j) + k]) * kSums;
            for (int f = 0; f < kSums; ++f) total[f] += back.sums[k][f][j];
        }
}

void backward_block(const Skinning& in, const float* records, int64_t begin, int count, const float* g_moved, const float* g_turned, const SkinningGrad& out,
                    Block& b, Back& back, float* totals) {
    load_and_weigh(in, records, begin, count, b);
    for (int j = 0; j < kBlock; ++j) {
        const int64_t i = begin + j;
        for (int c = 0; c < 3; ++c) back.g[c][j] = j < count ? g_moved[3 * i + c] : 0.0f;
        for (int c = 0; c < 4; ++c) back.u[c][j] = 0;
        if (j >= count) continue;
        const float inverse = b.inverse[j];
        float unit[4], g[4], along = 0;
        for (int c = 0; c < 4; ++c) unit[c] = b.blend[c][j] * inverse, g[c] = g_turned[4 * i + c];
        if (in.quats) {
            const float *q = in.quats + 4 * i, conjugate[4] = {q[0], -q[1], -q[2], -q[3]}, back_turn[4] = {unit[0], -unit[1], -unit[2], -unit[3]};
            float of_unit[4];
            product(g, conjugate, of_unit);
            product(back_turn, g, out.quats + 4 * i);
            std::copy(of_unit, of_unit + 4, g);
        }
        for (int c = 0; c < 4; ++c) along += g[c] * unit[c];
        const bool normal = inverse < 1.0f / kLeastNorm;
        for (int c = 0; c < 4; ++c) back.u[c][j] = (g[c] - (normal ? along * unit[c] : 0.0f)) * inverse;
    }
    back_through_weights(in, b, back);
    add_to_nodes(in, begin, count, back, totals);
    for (int j = 0; j < count; ++j) {
        for (int c = 0; c < 3; ++c) out.rest[3 * (begin + j) + c] = back.x[c][j];
        for (int c = 0; c < in.hyper; ++c) out.rest_hyper[in.hyper * (begin + j) + c] = back.h[c][j];
    }
}

// From sums over positions to a node's own parameters.
void finish_node(const Skinning& in, int b, const double* sum, const SkinningGrad& out) {
    const float *q = in.turns + 4 * b, w = q[0], x = q[1], y = q[2], z = q[3];
    const double* r = sum + gR;
    const double g[4] = {2 * (-z * r[1] + y * r[2] + z * r[3] - x * r[5] - y * r[6] + x * r[7]),
                         2 * (y * r[1] + z * r[2] + y * r[3] - 2 * x * r[4] - w * r[5] + z * r[6] + w * r[7] - 2 * x * r[8]),
                         2 * (-2 * y * r[0] + x * r[1] + w * r[2] + x * r[3] + z * r[5] - w * r[6] + z * r[7] - 2 * y * r[8]),
                         2 * (-2 * z * r[0] - w * r[1] + x * r[2] + w * r[3] - 2 * z * r[4] + y * r[5] + x * r[6] + y * r[7])};
    for (int c = 0; c < 4; ++c) out.turns[4 * b + c] = float(g[c] + sum[gQuat + c]);
    for (int c = 0; c < 3; ++c) out.shifts[3 * b + c] = float(sum[gShift + c]);
    out.falloff[b] = float(sum[gFalloff]);
    for (int c = 0; c < in.hyper; ++c) out.home_hyper[in.hyper * b + c] = float(sum[gHyper + c]);
}

E4DGS_CLONES void nearest_of_block(const Skinning& in, int64_t begin, int count, int32_t* link) {
    float x[3][kBlock], h[kMostHyper][kBlock], best[kMostLinks][kBlock];
    int32_t node[kMostLinks][kBlock];
    for (int j = 0; j < kBlock; ++j) {
        const int64_t i = begin + std::min(j, count - 1);
        for (int c = 0; c < 3; ++c) x[c][j] = in.rest[3 * i + c];
        for (int c = 0; c < in.hyper; ++c) h[c][j] = in.rest_hyper[in.hyper * i + c];
        for (int k = 0; k < in.links; ++k) best[k][j] = std::numeric_limits<float>::infinity(), node[k][j] = 0;
    }
    for (int b = 0; b < in.nodes; ++b) {
        const float* home = in.home + 3 * b;
        float value[kBlock];
        int32_t number[kBlock];
        for (int j = 0; j < kBlock; ++j) {
            const float dx = x[0][j] - home[0], dy = x[1][j] - home[1], dz = x[2][j] - home[2];
            value[j] = dx * dx + dy * dy + dz * dz;
            number[j] = b;
        }
        for (int c = 0; c < in.hyper; ++c)
            for (int j = 0; j < kBlock; ++j) {
                const float d = h[c][j] - in.home_hyper[in.hyper * b + c];
                value[j] += d * d;
            }
        for (int j = 0; j < kBlock; ++j) value[j] *= in.falloff[b];
        for (int k = 0; k < in.links; ++k)  // pushes what is farther down the list
            for (int j = 0; j < kBlock; ++j) {
                const bool nearer = value[j] < best[k][j];
                const float v = nearer ? best[k][j] : value[j];
                const int32_t m = nearer ? node[k][j] : number[j];
                best[k][j] = nearer ? value[j] : best[k][j];
                node[k][j] = nearer ? number[j] : node[k][j];
                value[j] = v, number[j] = m;
            }
    }
    for (int j = 0; j < count; ++j)
        for (int k = 0; k < in.links; ++k) link[in.links * (begin + j) + k] = node[k][j];
}

}  // namespace

void skin_forward(const Skinning& in, float* moved, float* turned, int threads) {
    const std::vector<float> records = records_of(in);
    const int64_t blocks = (in.n + kBlock - 1) / kBlock;
#pragma omp parallel num_threads(threads)
    {
        std::vector<Block> scratch(1);
#pragma omp for schedule(static)
        for (int64_t k = 0; k < blocks; ++k)
            forward_block(in, records.data(), k * kBlock, int(std::min<int64_t>(kBlock, in.n - k * kBlock)), scratch[0], moved, turned);
    }
}

void skin_backward(const Skinning& in, const float* g_moved, const float* g_turned, const SkinningGrad& out, int threads) {
    const std::vector<float> records = records_of(in);
    const size_t width = size_t(in.nodes) * kSums;
    std::vector<double> sums(width, 0.0);
    const int64_t ranges = (in.n + kRange - 1) / kRange;
    constexpr int64_t kTogether = 64;  // ranges whose totals are kept at once
    std::vector<float> totals(size_t(std::min(ranges, kTogether)) * width);
    for (int64_t first = 0; first < ranges; first += kTogether) {
        const int64_t last = std::min(ranges, first + kTogether);
#pragma omp parallel num_threads(threads)
        {
            std::vector<Block> block(1);
            std::vector<Back> back(1);
#pragma omp for schedule(static)
            for (int64_t r = first; r < last; ++r) {
                float* mine = totals.data() + size_t(r - first) * width;
                std::fill(mine, mine + width, 0.0f);
                for (int64_t i = r * kRange; i < std::min(in.n, (r + 1) * kRange); i += kBlock)
                    backward_block(in, records.data(), i, int(std::min<int64_t>(kBlock, in.n - i)), g_moved, g_turned, out, block[0], back[0], mine);
            }
#pragma omp for schedule(static)
            for (int64_t f = 0; f < int64_t(width); ++f)
                for (int64_t r = 0; r < last - first; ++r) sums[size_t(f)] += totals[size_t(r) * width + size_t(f)];
        }
    }
    for (int b = 0; b < in.nodes; ++b) finish_node(in, b, &sums[size_t(b) * kSums], out);
}

void nearest_nodes(const Skinning& in, int32_t* link, int threads) {
    const int64_t blocks = (in.n + kBlock - 1) / kBlock;
#pragma omp parallel for schedule(static) num_threads(threads)
    for (int64_t k = 0; k < blocks; ++k) nearest_of_block(in, k * kBlock, int(std::min<int64_t>(kBlock, in.n - k * kBlock)), link);
}

}  // namespace e4dgs
