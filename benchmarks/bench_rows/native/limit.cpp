// The least that blending can cost: evaluates and blends pairs of a pixel and a Gaussian from a list that lies in the nearest cache, and
// does nothing else: no culling, sorting, tiles, gathering or skipping, no depth and no stop. Made of the rasterizer's own vectors and
// formulas (rasterizer/cpu), for the instruction set that library.py names: E4DGS_ISA, and INSTRUCTIONS, its simd_*.h.
#include INSTRUCTIONS
//
#include "blend.h"
#include "parallel.h"

namespace E4DGS_ISA {
namespace {

using namespace e4dgs;

#include "elementary.inl"
#include "items.inl"
#include "gaussian_alpha.inl"

constexpr int kItems = 64;    // a typical block's list; then the pixels start again
constexpr int kCovered = 64;  // that one Gaussian covers in a tile

struct LimitScene {
    Item items[kItems];
    alignas(64) float colour[3][kCovered];  // forward's result, and backward's incoming gradient
    alignas(64) float behind[kCovered], transmittance[kCovered];
    alignas(64) float sums[kItems][16];
};

inline void limit_scene(LimitScene& scene) {
    for (int j = 0; j < kItems; ++j) {
        Item& item = scene.items[j];
        item = Item{};
        item.f0 = 0.05f + 0.001f * float(j % 7), item.f1 = 0.01f * float(j % 5 - 2), item.f2 = 0.06f;
        item.u = 0.02f * float(j % 11 - 5), item.v = 0.03f * float(j % 13 - 6);
        item.exponent = -4.0f - 0.01f * float(j);  // alpha about 0.05: the pixels stay transparent, and every pair counts
        for (int c = 0; c < 3; ++c) item.color[c] = 0.1f * float((j + 3 * c) % 10);
        item.convex = -1;
    }
    for (int i = 0; i < kCovered; ++i) {
        for (int c = 0; c < 3; ++c) scene.colour[c][i] = 0.01f * float(i + c);
        scene.behind[i] = 0.1f, scene.transmittance[i] = 0.05f;
    }
}

inline void limit_forward(LimitScene& scene) {
    for (int k = 0; k < kCovered / kWidth; ++k) {
        const Float X = load(kLaneX + k % kVectors * kWidth) + set1(float(k)), Y = load(kLaneY + k % kVectors * kWidth);
        Float T = set1(1.0f), red = zero(), green = zero(), blue = zero(), u, v;
        for (const Item& item : scene.items) {
            Mask counted;
            const Float raw = gaussian_alpha(item, X, Y, u, v, counted);
            const Float alpha = keep(counted, min(raw, set1(kMaxAlpha))), w = T * alpha;
            T = fnma(T, alpha, T);
            red = fma(w, set1(item.color[0]), red);
            green = fma(w, set1(item.color[1]), green);
            blue = fma(w, set1(item.color[2]), blue);
        }
        store(scene.colour[0] + k * kWidth, red), store(scene.colour[1] + k * kWidth, green), store(scene.colour[2] + k * kWidth, blue);
    }
}

// Nine gradients a Gaussian: colour 3, and sum g (1, u, v, uu, uv, vv).
inline void limit_backward(LimitScene& scene) {
    for (int j = kItems - 1; j >= 0; --j) {
        const Item& item = scene.items[j];
        Float sums[9] = {zero(), zero(), zero(), zero(), zero(), zero(), zero(), zero(), zero()};
        for (int k = 0; k < kCovered / kWidth; ++k) {
            const int at = k * kWidth, lane = k % kVectors * kWidth;
            Float u, v;
            Mask counted;
            const Float raw = gaussian_alpha(item, load(kLaneX + lane) + set1(float(k)), load(kLaneY + lane), u, v, counted);
            const Float alpha = keep(counted, min(raw, set1(kMaxAlpha)));
            const Float inverse = reciprocal(set1(1.0f) - alpha);
            const Float before = load(scene.transmittance + at) * inverse, behind = load(scene.behind + at), w = before * alpha;
            const Float red = load(scene.colour[0] + at), green = load(scene.colour[1] + at), blue = load(scene.colour[2] + at);
            const Float f = fma(red, set1(item.color[0]), fma(green, set1(item.color[1]), blue * set1(item.color[2])));
            sums[0] = fma(w, red, sums[0]), sums[1] = fma(w, green, sums[1]), sums[2] = fma(w, blue, sums[2]);
            store(scene.transmittance + at, before);
            store(scene.behind + at, fma(w, f, behind));
            const Float g = keep(raw < set1(kMaxAlpha), alpha * fnma(behind, inverse, before * f)), gu = g * u, gv = g * v;
            sums[3] = sums[3] + g, sums[4] = sums[4] + gu, sums[5] = sums[5] + gv;
            sums[6] = fma(gu, u, sums[6]), sums[7] = fma(gu, v, sums[7]), sums[8] = fma(gv, v, sums[8]);
        }
        sum_lanes<9>(sums, scene.sums[j]);
    }
    for (int i = 0; i < kCovered; ++i) scene.behind[i] = 0.1f, scene.transmittance[i] = 0.05f;
}

void run(int64_t pairs, bool backward) {
    LimitScene scene;
    limit_scene(scene);
    const int64_t rounds = pairs / (kCovered * kItems);
    for (int64_t r = 0; r < rounds; ++r) {
        asm volatile("" ::"r"(&scene) : "memory");  // nothing is carried over from round to round, nor left out
        backward ? limit_backward(scene) : limit_forward(scene);
    }
}

}  // namespace
}  // namespace E4DGS_ISA

extern "C" void blend_limit(int64_t pairs, int backward, int threads) {
    e4dgs::parallel_blocks(threads, 1, threads, [&](int64_t, int64_t, int64_t) { E4DGS_ISA::run(pairs / threads, backward != 0); });
}
