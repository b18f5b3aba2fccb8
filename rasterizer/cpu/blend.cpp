// Runs the kernels over the tiles, and selects the kernels that suit the processor.
#include "blend.h"

#include <algorithm>
#include <string_view>
#include <vector>

#include "flush.h"
#include "parallel.h"
#include "project.h"
#include "state.h"

#if defined(E4DGS_X86)
namespace e4dgs_avx2 {
extern const e4dgs::Kernels kKernels;
extern const e4dgs::ProjectKernels kProjectKernels;
}
namespace e4dgs_avx512 {
extern const e4dgs::Kernels kKernels;
extern const e4dgs::ProjectKernels kProjectKernels;
}
#endif
namespace e4dgs_baseline {
extern const e4dgs::Kernels kKernels;
extern const e4dgs::ProjectKernels kProjectKernels;
}

namespace e4dgs {
namespace {

struct Choice {
    const Kernels* blend;
    const ProjectKernels* project;
};

// Best first.
std::vector<Choice> available() {
    std::vector<Choice> found;
#if defined(E4DGS_X86)
    __builtin_cpu_init();
    const bool avx2 = __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma") && __builtin_cpu_supports("bmi2");
    if (avx2 && __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512bw") && __builtin_cpu_supports("avx512cd") &&
        __builtin_cpu_supports("avx512dq") && __builtin_cpu_supports("avx512vl"))
        found.push_back({&e4dgs_avx512::kKernels, &e4dgs_avx512::kProjectKernels});
    if (avx2) found.push_back({&e4dgs_avx2::kKernels, &e4dgs_avx2::kProjectKernels});
#endif
    found.push_back({&e4dgs_baseline::kKernels, &e4dgs_baseline::kProjectKernels});
    return found;
}

Choice& chosen() {
    static Choice choice = available().front();
    return choice;
}

void fill_job(const State& state, TileJob& job) {
    const SceneInput& scene = state.scene;
    job.width = scene.camera.width, job.height = scene.camera.height, job.tiles_x = state.tiles_x;
    job.n_gaussians = uint32_t(scene.gaussians.n);
    job.points = scene.convexes.points_each;
    job.gaussians = state.gaussians.data(), job.convexes = state.convexes.data();
    job.gaussian_extras = scene.gaussians.extras, job.convex_extras = scene.convexes.extras;
    job.extras = scene.extras;
    job.tile_begin = state.tile_begin.data(), job.entries = state.entries.data();
    job.masks = const_cast<uint16_t*>(state.masks.data());
    std::copy(scene.background, scene.background + 3, job.background);
    job.transmittance = const_cast<float*>(state.transmittance.data());
    job.last = const_cast<int32_t*>(state.last.data());
}

}  // namespace

const Kernels& kernels() { return *chosen().blend; }
const ProjectKernels& project_kernels() { return *chosen().project; }

bool select_kernels(const char* name) {
    for (const Choice& choice : available())
        if (std::string_view(choice.blend->name) == name) return chosen() = choice, true;
    return false;
}

void blend_forward(State& state, const FrameOutput& out, bool keep, int threads) {
    const size_t pixels = size_t(state.scene.camera.width) * state.scene.camera.height;
    if (keep) state.transmittance.resize(pixels), state.last.resize(pixels);
    ForwardJob job;
    fill_job(state, job);
    job.color = out.color, job.alpha = out.alpha, job.depth = out.depth, job.extra = out.extras;
    job.visible_gaussians = out.visible_gaussians, job.visible_convexes = out.visible_convexes;
    const auto run = kernels().forward;
    parallel_blocks(state.tiles(), 4, threads, [&](int64_t first, int64_t last, int64_t) {
        [[maybe_unused]] const FlushDenormals flush;
        Buffer<float> scratch(scratch_floats(job.extras));
        for (int64_t tile = first; tile < last; ++tile) run(job, int(tile), scratch.data());
    });
}

void blend_backward(const State& state, const FrameGrad& grad, Buffer<float>& slots, Buffer<uint8_t>& touched, double* background,
                    bool attribution, int threads) {
    BackwardJob job;
    fill_job(state, job);
    job.grad_color = grad.color, job.grad_alpha = grad.alpha, job.grad_depth = grad.depth, job.grad_extras = grad.extras;
    job.alpha = grad.alpha_image, job.depth = grad.depth_image;
    const size_t units = state.slot_begin[state.depth.size()];
    slots.resize(units * 4);
    touched.resize(units);
    std::fill(touched.begin(), touched.end(), uint8_t(0));
    Buffer<double> parts(background ? size_t(state.tiles()) * 3 : 0);
    job.slots = slots.data(), job.touched = touched.data(), job.grad_background = background ? parts.data() : nullptr;
    const auto run = attribution ? kernels().attribute : kernels().backward;
    parallel_blocks(state.tiles(), 4, threads, [&](int64_t first, int64_t last, int64_t) {
        [[maybe_unused]] const FlushDenormals flush;
        Buffer<float> scratch(scratch_floats(job.extras));
        for (int64_t tile = first; tile < last; ++tile) run(job, int(tile), scratch.data());
    });
    for (int c = 0; background && c < 3; ++c) {
        background[c] = 0;
        for (int t = 0; t < state.tiles(); ++t) background[c] += parts[3 * t + c];
    }
}

}  // namespace e4dgs
