// Every primitive on its own: cull, project, colour. A primitive with a non-finite or out-of-range value is culled alone. Gaussians
// go through project.inl, many at a time; convexes one by one here.
#include <bit>
#include <cmath>
#include <limits>

#include "bounds.h"
#include "convex.h"
#include "parallel.h"
#include "project.h"
#include "sh.h"
#include "state.h"

namespace e4dgs {
namespace {

constexpr double kLargest = std::numeric_limits<float>::max();

bool finite(const float* x, int64_t n) {
    uint32_t bad = 0;  // on the bits, so that the loop is vectorised
    for (int64_t i = 0; i < n; ++i) bad |= uint32_t((std::bit_cast<uint32_t>(x[i]) & 0x7f800000u) == 0x7f800000u);
    return bad == 0;
}

int coefficients(int degree) { return (degree + 1) * (degree + 1); }

bool usable(const Looks& in, int64_t i, int extras) {
    const float o = in.opacities[i];
    if (!(o >= 0.0f && o <= 1.0f)) return false;
    if (in.sh ? !finite(in.sh + i * coefficients(in.degree) * 3, coefficients(in.degree) * 3) : !finite(in.colors + i * 3, 3)) return false;
    return !in.extras || finite(in.extras + i * extras, extras);
}

bool positive(const float* x, int n) {
    bool good = true;
    for (int i = 0; i < n; ++i) good &= x[i] > 0.0f && x[i] <= kLargest;
    return good;
}

void colour(const Looks& in, int64_t i, const Camera<double>& camera, const double* position, float* out) {
    double c[3];
    if (in.colors) {
        for (int k = 0; k < 3; ++k) out[k] = in.colors[3 * i + k];
        return;
    }
    const float* sh = in.sh + i * coefficients(in.degree) * 3;
    switch (in.degree) {
        case 0: sh_color<0>(camera, position, sh, c); break;
        case 1: sh_color<1>(camera, position, sh, c); break;
        case 2: sh_color<2>(camera, position, sh, c); break;
        default: sh_color<3>(camera, position, sh, c);
    }
    for (int k = 0; k < 3; ++k) out[k] = float(c[k]);
}

bool convex(const State& state, int64_t i, ConvexRecord& record, TileBox& box, double& z) {
    const SceneInput& scene = state.scene;
    const ConvexInput& in = scene.convexes;
    const int points = in.points_each;
    const float* p = in.points + i * points * 3;
    if (!finite(p, points * 3) || !positive(in.tau + i, 1) || !positive(in.kappa + i, 1)) return false;
    const float opacity = in.opacities[i];
    constexpr float inverse = 1.0f / kMinAlpha;
    if (!(opacity * inverse > 1.0f && opacity <= 1.0f)) return false;

    ConvexView<double> view;
    if (!project_convex(scene.camera, p, points, view) || !usable(in, i, scene.extras)) return false;
    double centre[3] = {0, 0, 0}, c[3];
    for (int k = 0; k < points; ++k)
        for (int j = 0; j < 3; ++j) centre[j] += double(p[3 * k + j]) / points;
    to_camera(scene.camera, centre, c);
    const double tau = in.tau[i], kappa = in.kappa[i];
    record.x0 = scene.camera.fx * c[0] / c[2] + scene.camera.cx;
    record.y0 = scene.camera.fy * c[1] / c[2] + scene.camera.cy;
    record.n = view.n;
    edge_lines(scene.camera, view, tau, record.x0, record.y0, record.A, record.B, record.C);
    record.opacity = opacity;
    record.rho = float(kappa / tau);
    const double limit = std::log2(double(inverse) * opacity - 1.0) * tau / kappa;  // alpha >= kMinAlpha where tau S / ln 2 <= limit
    record.limit = float(limit + kSlack + 1e-5 * std::fabs(limit));
    double sum = record.limit;
    for (int k = 0; k < view.n; ++k) sum += record.A[k] + record.B[k] + record.C[k];
    if (!std::isfinite(sum) || !std::isfinite(record.rho) || !(view.zc <= kLargest)) return false;
    if (!tile_box(ConvexBounds(record, scene.camera.width, scene.camera.height), scene.camera.width, scene.camera.height, box)) return false;
    z = view.zc;
    record.z = float(z);
    colour(in, i, scene.camera, centre, record.color);
    return true;
}

}  // namespace

void preprocess(State& state, int threads) {
    const int64_t n = state.scene.gaussians.n, m = state.scene.convexes.n;
    state.gaussians.resize(n);
    state.convexes.resize(m);
    state.depth.resize(n + m);
    constexpr double culled = std::numeric_limits<double>::quiet_NaN();
    state.boxes.resize(n + m);
    const ProjectJob job{&state.scene, state.gaussians.data(), state.depth.data(), state.boxes.data()};
    const auto project = project_kernels().project;
    parallel_blocks(n, kProjectBlock, threads, [&](int64_t first, int64_t last, int64_t) { project(job, first, last); });
    parallel_blocks(m, 64, threads, [&](int64_t first, int64_t last, int64_t) {
        for (int64_t i = first; i < last; ++i)
            if (!convex(state, i, state.convexes[i], state.boxes[n + i], state.depth[n + i])) state.depth[n + i] = culled;
    });
}

}  // namespace e4dgs
