// Processes every primitive on its own: cull, project, colour. Works on many at a time, see project.inl.
#include "parallel.h"
#include "project.h"
#include "state.h"

namespace e4dgs {

void preprocess(State& state, int threads) {
    const int64_t n = state.scene.gaussians.n, m = state.scene.convexes.n;
    state.gaussians.resize(n);
    state.convexes.resize(m);
    state.depth.resize(n + m);
    state.boxes.resize(n + m);
    const ProjectKernels& kernels = project_kernels();
    const ProjectGaussians gaussians{&state.scene, state.gaussians.data(), state.depth.data(), state.boxes.data()};
    parallel_blocks(n, kProjectBlock, threads, [&](int64_t first, int64_t last, int64_t) { kernels.gaussians(gaussians, first, last); });
    const ProjectConvexes convexes{&state.scene, state.convexes.data(), state.depth.data() + n, state.boxes.data() + n};
    parallel_blocks(m, kProjectBlock, threads, [&](int64_t first, int64_t last, int64_t) { kernels.convexes(convexes, first, last); });
}

}  // namespace e4dgs
