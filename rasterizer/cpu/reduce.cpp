// The backward pass behind the tiles: sum every primitive's slots in the order of its tiles, then back through projection,
// hull and colour to the inputs. Sums run in a fixed order in double, so threads do not change a bit. Gaussians go through project.inl,
// many at a time; convexes one by one here.
#include <algorithm>
#include <cmath>
#include <vector>

#include "convex.h"
#include "parallel.h"
#include "project.h"
#include "sh.h"
#include "state.h"

namespace e4dgs {
namespace {

constexpr int64_t kGrain = 256;
constexpr int kMost = kConvexEdges + 3 * kMaxPoints;

struct Reducer {
    const State& state;
    const SceneGrad& out;
    const float* slots;
    const uint8_t* touched;
    bool extras;  // they carry gradients

    // sums [count]; false where no tile touched the primitive.
    bool sum(int64_t k, uint32_t units, int count, double* sums) const {
        bool any = false;
        for (int i = 0; i < count; ++i) sums[i] = 0;
        for (uint64_t s = state.slot_begin[k]; s < state.slot_begin[k + 1]; s += units) {
            if (!touched[s]) continue;
            any = true;
            for (int i = 0; i < count; ++i) sums[i] += slots[4 * s + i];
        }
        return any;
    }

    void sum_extras(int64_t k, uint32_t units, int at, float* grad) const {
        for (int e = 0; e < state.scene.extras; ++e) {
            double total = 0;
            for (uint64_t s = state.slot_begin[k]; extras && s < state.slot_begin[k + 1]; s += units)
                if (touched[s]) total += slots[4 * s + at + e];
            grad[e] = float(total);
        }
    }

    // dcolor -> sh or colors, and the position that SH is seen from.
    void colour(const Looks& in, const LooksGrad& grad, int64_t i, const double* position, const double* dcolor, double* dposition,
                CameraGrad<double>& camera) const {
        if (in.colors) {
            if (grad.colors)
                for (int c = 0; c < 3; ++c) grad.colors[3 * i + c] = float(dcolor[c]);
            return;
        }
        const int64_t at = i * (in.degree + 1) * (in.degree + 1) * 3;
        const float* sh = in.sh + at;
        float* dsh = grad.sh ? grad.sh + at : nullptr;
        const Camera<double>& cam = state.scene.camera;
        switch (in.degree) {
            case 0: sh_color_backward<0>(cam, position, sh, dcolor, dsh, dposition, camera); break;
            case 1: sh_color_backward<1>(cam, position, sh, dcolor, dsh, dposition, camera); break;
            case 2: sh_color_backward<2>(cam, position, sh, dcolor, dsh, dposition, camera); break;
            default: sh_color_backward<3>(cam, position, sh, dcolor, dsh, dposition, camera);
        }
    }

    void zero_row(int64_t i) const {
        const ConvexInput& in = state.scene.convexes;
        const ConvexGrad& grad = out.convexes;
        const auto clear = [i](float* to, int width) {
            if (to) std::fill_n(to + i * width, width, 0.0f);
        };
        clear(grad.points, 3 * in.points_each), clear(grad.tau, 1), clear(grad.kappa, 1), clear(grad.opacities, 1);
        clear(grad.colors, 3), clear(grad.sh, (in.degree + 1) * (in.degree + 1) * 3), clear(grad.extras, state.scene.extras);
    }

    void convex(int64_t k, CameraGrad<double>& camera) const {
        const int64_t i = k - state.scene.gaussians.n;
        const uint32_t units = uint32_t(state.convex_units());
        if (state.slot_begin[k] == state.slot_begin[k + 1]) return zero_row(i);  // culled: its record may be empty
        const ConvexRecord& record = state.convexes[i];
        const ConvexInput& in = state.scene.convexes;
        const ConvexGrad& grad = out.convexes;
        const int points = in.points_each, shape = kConvexEdges + 3 * record.n;
        double s[kMost];
        if (!sum(k, units, shape, s)) return zero_row(i);
        if (grad.extras) sum_extras(k, units, shape, grad.extras + i * state.scene.extras);
        if (grad.opacities) grad.opacities[i] = float(s[4] / in.opacities[i]);

        ConvexView<double> view;
        project_convex(state.scene.camera, in.points + i * points * 3, points, view);
        const double tau = in.tau[i], kappa = in.kappa[i], rho = kappa / tau;
        double gA[kMaxPoints], gB[kMaxPoints], gC[kMaxPoints], dpoints[3 * kMaxPoints] = {}, dtau = 0, dkappa = 0;
        for (int e = 0; e < record.n; ++e) {  // E = 2^(rho lse), alpha = opacity / (1 + E)
            const double* edge = s + kConvexEdges + 3 * e;
            gA[e] = -kLn2 * rho * edge[0], gB[e] = -kLn2 * rho * edge[1], gC[e] = -kLn2 * rho * edge[2];
        }
        project_convex_backward(state.scene.camera, view, in.points + i * points * 3, tau, kappa, record.x0, record.y0, gA, gB, gC,
                                -kLn2 * s[5], -kLn2 * s[6], s[3], dpoints, dtau, dkappa, camera);
        double centre[3] = {}, dcentre[3] = {};
        for (int p = 0; p < points; ++p)
            for (int j = 0; j < 3; ++j) centre[j] += double(in.points[(i * points + p) * 3 + j]) / points;
        colour(in, grad, i, centre, s, dcentre, camera);
        for (int p = 0; grad.points && p < points; ++p)
            for (int j = 0; j < 3; ++j) grad.points[(i * points + p) * 3 + j] = float(dpoints[3 * p + j] + dcentre[j] / points);
        if (grad.tau) grad.tau[i] = float(dtau);
        if (grad.kappa) grad.kappa[i] = float(dkappa);
    }
};

// fx fy cx cy, then the 3x4 of cam_from_world.
void write_camera(const CameraGrad<double>& grad, double* out) {
    out[0] = grad.fx, out[1] = grad.fy, out[2] = grad.cx, out[3] = grad.cy;
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) out[4 + 4 * i + j] = grad.R[3 * i + j];
        out[4 + 4 * i + 3] = grad.t[i];
    }
}

}  // namespace

void backward(const State& state, const FrameGrad& grad, const SceneGrad& out, int threads) {
    Buffer<float> slots;
    Buffer<uint8_t> touched;
    Clock clock;
    blend_backward(state, grad, slots, touched, out.background, threads);
    clock(state.seconds.blend_backward);

    const int64_t n = state.scene.gaussians.n, m = state.scene.convexes.n;
    const int64_t blocks = (n + kProjectBlock - 1) / kProjectBlock;
    std::vector<double> parts(16 * size_t(blocks + (m + kGrain - 1) / kGrain));
    const BackprojectJob job{&state.scene,   state.gaussians.data(), state.slot_begin.data(), slots.data(), touched.data(),
                             uint32_t(state.gaussian_units()), grad.extras != nullptr, out.gaussians};
    const auto backproject = project_kernels().backproject;
    parallel_blocks(n, kProjectBlock, threads, [&](int64_t first, int64_t last, int64_t block) {
        backproject(job, first, last, out.camera ? parts.data() + 16 * block : nullptr);
    });
    const Reducer reducer{state, out, slots.data(), touched.data(), grad.extras != nullptr};
    parallel_blocks(m, kGrain, threads, [&](int64_t first, int64_t last, int64_t block) {
        CameraGrad<double> camera{};
        for (int64_t i = first; i < last; ++i) reducer.convex(n + i, camera);
        write_camera(camera, parts.data() + 16 * (blocks + block));
    });
    clock(state.seconds.reduce);
    if (!out.camera) return;
    for (int i = 0; i < 16; ++i) out.camera[i] = 0;
    for (size_t at = 0; at < parts.size(); ++at) out.camera[at % 16] += parts[at];
}

}  // namespace e4dgs
