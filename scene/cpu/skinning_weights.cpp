#include "skinning_weights.h"

#include <algorithm>
#include <cstring>
#include <limits>

#include "clones.h"
#include "exp.h"

namespace e4dgs {
namespace {

typedef float Place __attribute__((vector_size(4 * kPlace)));

}  // namespace

Frames frames_of(const Skinning& in) {
    Frames frames{{in.home[0], in.home[1], in.home[2]}, std::vector<float>(size_t(in.nodes) * kRigid), std::vector<float>(size_t(in.nodes) * kPlace)};
    for (int b = 0; b < in.nodes; ++b) {
        const float *q = in.turns + 4 * b, w = q[0], x = q[1], y = q[2], z = q[3];
        float *r = &frames.rigid[size_t(b) * kRigid], *home = &frames.place[size_t(b) * kPlace];
        // The rotation matrix of a unit quaternion: v + 2 w (a x v) + 2 a x (a x v).
        const float matrix[9] = {1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y), 2 * (x * y + w * z), 1 - 2 * (x * x + z * z),
                                 2 * (y * z - w * x), 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)};
        std::copy(matrix, matrix + 9, r + kR);
        for (int j = 0; j < 3; ++j) home[j] = in.home[3 * b + j] - frames.origin[j];
        for (int j = 0; j < 3; ++j)
            r[kShift + j] = home[j] + in.shifts[3 * b + j] - matrix[3 * j] * home[0] - matrix[3 * j + 1] * home[1] - matrix[3 * j + 2] * home[2];
        std::copy(q, q + 4, r + kQuat);
        std::copy(in.home_hyper + in.hyper * b, in.home_hyper + in.hyper * (b + 1), home + kHyper);
        home[kFalloff] = in.falloff[b];
    }
    return frames;
}

E4DGS_CLONES void weigh(const Skinning& in, const Frames& frames, const Block& block, Weights& out) {
    const int links = in.links, hyper = in.hyper;
    alignas(64) float at[kBlock][kPlace] = {}, away[kBlock][kPlace];
    float best[kBlock], total[kBlock];
    int32_t link[kMostLinks][kBlock];
    for (int j = 0; j < kBlock; ++j) {
        const int64_t i = block.row[std::min(j, block.count - 1)];
        for (int c = 0; c < 3; ++c) at[j][c] = in.rest[3 * i + c] - frames.origin[c];
        for (int c = 0; c < hyper; ++c) at[j][kHyper + c] = in.rest_hyper[hyper * i + c];
        for (int k = 0; k < links; ++k) link[k][j] = in.link[links * i + k];
    }
    for (int j = 0; j < kBlock; ++j) best[j] = -std::numeric_limits<float>::max(), total[j] = 0;
    const float* place = frames.place.data();
    for (int k = 0; k < links; ++k) {
        for (int j = 0; j < kBlock; ++j) {
            Place a, b;
            std::memcpy(&a, at[j], sizeof a), std::memcpy(&b, place + size_t(link[k][j]) * kPlace, sizeof b);
            a -= b;
            std::memcpy(away[j], &a, sizeof a);
        }
        for (int j = 0; j < kBlock; ++j) {
            float d2 = 0;
            for (int c = 0; c < kFalloff; ++c) d2 += away[j][c] * away[j][c];
            out.d2[k][j] = d2, out.value[k][j] = d2 * away[j][kFalloff];
        }
        for (int j = 0; j < kBlock; ++j) best[j] = std::max(best[j], out.value[k][j]);
    }
    for (int k = 0; k < links; ++k)
        for (int j = 0; j < kBlock; ++j) total[j] += out.value[k][j] = exp_of(out.value[k][j] - best[j]);
    for (int k = 0; k < links; ++k)
        for (int j = 0; j < kBlock; ++j) out.value[k][j] /= total[j];
}

}  // namespace e4dgs
