// The backward pass: first over the tiles; then each primitive's slots are summed and propagated back to the inputs. Sums are in double and
// in a fixed order, so the number of threads does not change a single bit.
#include <vector>

#include "parallel.h"
#include "project.h"
#include "state.h"

namespace e4dgs {

void backward(const State& state, const FrameGrad& grad, const SceneGrad& out, int threads) {
    Buffer<float> slots;
    Buffer<uint8_t> touched;
    blend_backward(state, grad, slots, touched, out.background, threads);

    const int64_t n = state.scene.gaussians.n, m = state.scene.convexes.n;
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
