// The search for the nodes that carry a position: it compares a block of positions at a time with every node.
#include <algorithm>
#include <limits>

#include "clones.h"
#include "skinning.h"

namespace e4dgs {
namespace {

constexpr int kBlock = 64;  // positions that are compared with a node at once

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
        for (int k = 0; k < in.links; ++k)  // insertion into the sorted list: farther nodes move down
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

void nearest_nodes(const Skinning& in, int32_t* link, int threads) {
    const int64_t blocks = (in.n + kBlock - 1) / kBlock;
#pragma omp parallel for schedule(static) num_threads(threads)
    for (int64_t k = 0; k < blocks; ++k) nearest_of_block(in, k * kBlock, int(std::min<int64_t>(kBlock, in.n - k * kBlock)), link);
}

}  // namespace e4dgs
