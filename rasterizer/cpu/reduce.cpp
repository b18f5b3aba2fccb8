// The backward pass: first over the tiles; then each primitive's slots are summed and propagated back to the inputs. Sums are in double and
// in a fixed order, so the number of threads does not change a single bit.
#include <vector>

#include "blend.h"
#include "parallel.h"
#include "project.h"
#include "state.h"

namespace e4dgs {
namespace {

bool asks(const LooksGrad& looks) { return looks.opacities || looks.sh || looks.colors; }

// Whether the blending weights suffice, because nothing but the extras' gradients is asked for.
bool extras_alone(const State& state, const FrameGrad& grad, const SceneGrad& out) {
    const GaussianGrad& g = out.gaussians;
    const ConvexGrad& c = out.convexes;
    const bool others = out.camera || out.background || asks(g) || asks(c) || g.means || g.quats || g.scales || c.points || c.tau || c.kappa;
    return grad.extras && !others && state.scene.extras <= kMostAttributed;
}

// The sums at the beginning of the slots of n primitives, to out [n, extras].
void sum_attributed(const uint32_t* slot_begin, uint32_t units, int64_t n, int extras, const float* slots, const uint8_t* touched, float* out,
                    int threads) {
    if (!out) return;
    parallel_blocks(n, kProjectBlock, threads, [&](int64_t first, int64_t last, int64_t) {
        for (int64_t i = first; i < last; ++i) {
            double sums[kMostAttributed] = {};
            for (uint64_t s = slot_begin[i]; s < slot_begin[i + 1]; s += units)
                for (int e = 0; touched[s] && e < extras; ++e) sums[e] += double(slots[4 * s + uint64_t(e)]);
            for (int e = 0; e < extras; ++e) out[i * extras + e] = float(sums[e]);
        }
    });
}

}  // namespace

void backward(const State& state, const FrameGrad& grad, const SceneGrad& out, int threads) {
    Buffer<float> slots;
    Buffer<uint8_t> touched;
    const bool attribution = extras_alone(state, grad, out);
    blend_backward(state, grad, slots, touched, out.background, attribution, threads);

    const int64_t n = state.scene.gaussians.n, m = state.scene.convexes.n;
    if (attribution) {
        const auto sum = [&](const uint32_t* begin, int units, int64_t count, float* to) {
            sum_attributed(begin, uint32_t(units), count, state.scene.extras, slots.data(), touched.data(), to, threads);
        };
        sum(state.slot_begin.data(), state.gaussian_units(), n, out.gaussians.extras);
        sum(state.slot_begin.data() + n, state.convex_units(), m, out.convexes.extras);
        return;
    }
    const int64_t blocks = (n + kProjectBlock - 1) / kProjectBlock, convex_blocks = (m + kProjectBlock - 1) / kProjectBlock;
    std::vector<double> parts(16 * size_t(blocks + convex_blocks));
    const bool extras = grad.extras != nullptr;
    const auto camera = [&](int64_t block) { return out.camera ? parts.data() + 16 * block : nullptr; };
    const ProjectKernels& kernels = project_kernels();
    const BackprojectGaussians gaussians{&state.scene,   state.gaussians.data(), state.slot_begin.data(), slots.data(), touched.data(),
                                         uint32_t(state.gaussian_units()), extras, out.gaussians};
    parallel_blocks(n, kProjectBlock, threads, [&](int64_t first, int64_t last, int64_t block) {
        kernels.gaussians_back(gaussians, first, last, camera(block));
    });
    const BackprojectConvexes convexes{&state.scene,   state.convexes.data(), state.slot_begin.data() + n, slots.data(), touched.data(),
                                       uint32_t(state.convex_units()), extras, out.convexes};
    parallel_blocks(m, kProjectBlock, threads, [&](int64_t first, int64_t last, int64_t block) {
        kernels.convexes_back(convexes, first, last, camera(blocks + block));
    });
    if (!out.camera) return;
    for (int i = 0; i < 16; ++i) out.camera[i] = 0;
    for (size_t at = 0; at < parts.size(); ++at) out.camera[at % 16] += parts[at];
}

}  // namespace e4dgs
