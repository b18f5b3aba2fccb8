// Counts (pixel, primitive) pairs, for benchmarks: plain scalar code, slow, and independent of the kernels it judges.
#include <algorithm>
#include <atomic>
#include <cmath>

#include "parallel.h"
#include "state.h"

namespace e4dgs {
namespace {

double alpha_at(const State& state, uint32_t id, double x, double y) {
    const uint32_t n = uint32_t(state.scene.gaussians.n);
    if (id < n) {
        const GaussianRecord& r = state.gaussians[id];
        const double u = r.f[0] * (x - r.x) + r.f[1] * (y - r.y), v = r.f[2] * (y - r.y);
        return std::exp2(double(r.exponent) - u * u - v * v);
    }
    const ConvexRecord& r = state.convexes[id - n];
    double line[kMaxPoints], top = -INFINITY, sum = 0;
    for (int i = 0; i < r.n; ++i) top = std::max(top, line[i] = r.A()[i] * (x - r.x0) + r.B()[i] * (y - r.y0) + r.C()[i]);
    for (int i = 0; i < r.n; ++i) sum += std::exp2(line[i] - top);
    return r.opacity / (1 + std::exp2(r.rho * (top + std::log2(sum))));
}

}  // namespace

PairCount count_pairs(const State& state, int threads) {
    std::atomic<uint64_t> visible{0}, blended{0};
    const int width = state.scene.camera.width, height = state.scene.camera.height;
    parallel_blocks(state.tiles(), 4, threads, [&](int64_t first, int64_t last, int64_t) {
        for (int64_t tile = first; tile < last; ++tile) {
            const int x0 = int(tile % state.tiles_x) * kTile, y0 = int(tile / state.tiles_x) * kTile;
            for (int y = y0; y < std::min(y0 + kTile, height); ++y)
                for (int x = x0; x < std::min(x0 + kTile, width); ++x) {
                    uint64_t passed = 0, used = 0;
                    double t = 1;
                    for (uint64_t e = state.tile_begin[tile]; e < state.tile_begin[tile + 1]; ++e) {
                        const double alpha = std::min(alpha_at(state, state.entries[e].primitive, x + 0.5, y + 0.5), double(kMaxAlpha));
                        if (alpha < kMinAlpha) continue;
                        ++passed;
                        t *= 1 - alpha;
                        used += t >= kMinTransmittance;
                    }
                    visible += passed, blended += used;
                }
        }
    });
    return {visible, blended};
}

}  // namespace e4dgs
