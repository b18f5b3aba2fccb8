// The backward pass behind the tiles: sum every primitive's slots in the order of its tiles, then back through projection,
// hull and colour to the inputs. Sums run in a fixed order in double, so threads do not change a bit.
#include <cmath>

#include "convex.h"
#include "gaussian.h"
#include "parallel.h"
#include "sh.h"
#include "state.h"

namespace e4dgs {
namespace {

constexpr int64_t kGrain = 256;
constexpr int kMost = 4 + 2 + 3 * kMaxPoints;

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
            for (uint64_t s = state.slot_begin[k]; s < state.slot_begin[k + 1]; s += units)
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

    void gaussian(int64_t k, CameraGrad<double>& camera) const {
        const int64_t i = k;
        const uint32_t units = uint32_t(state.gaussian_units());
        double s[10];
        if (!sum(k, units, 10, s)) return;
        const GaussianInput& in = state.scene.gaussians;
        const GaussianGrad& grad = out.gaussians;
        if (extras && grad.extras) sum_extras(k, units, 10, grad.extras + i * state.scene.extras);
        if (grad.opacities) grad.opacities[i] = float(s[4] / in.opacities[i]);

        GaussianView<double> view;
        project_gaussian(state.scene.camera, in.means + 3 * i, in.quats + 4 * i, in.scales + 3 * i, view);
        double dmean2[2], dcov[3], dmean[3] = {}, dquat[4] = {}, dscale[3] = {}, moments[5];
        for (int j = 0; j < 5; ++j) moments[j] = s[5 + j] * kLn2;  // alpha = 2^e
        moments_backward(state.gaussians[i].f, moments, dmean2, dcov);
        project_gaussian_backward(state.scene.camera, view, in.means + 3 * i, in.scales + 3 * i, dmean2, dcov, s[3], dmean, dquat, dscale, camera);
        const double position[3] = {in.means[3 * i], in.means[3 * i + 1], in.means[3 * i + 2]};
        colour(in, grad, i, position, s, dmean, camera);
        for (int j = 0; j < 3; ++j) {
            if (grad.means) grad.means[3 * i + j] = float(dmean[j]);
            if (grad.scales) grad.scales[3 * i + j] = float(dscale[j]);
        }
        for (int j = 0; grad.quats && j < 4; ++j) grad.quats[4 * i + j] = float(dquat[j]);
    }

    void convex(int64_t k, CameraGrad<double>& camera) const {
        const int64_t i = k - state.scene.gaussians.n;
        const uint32_t units = uint32_t(state.convex_units());
        const ConvexRecord& record = state.convexes[i];
        const ConvexInput& in = state.scene.convexes;
        const ConvexGrad& grad = out.convexes;
        const int points = in.points_each, shape = 6 + 3 * record.n;
        double s[kMost];
        if (!sum(k, units, shape, s)) return;
        if (extras && grad.extras) sum_extras(k, units, shape, grad.extras + i * state.scene.extras);
        if (grad.opacities) grad.opacities[i] = float(s[4] / in.opacities[i]);

        ConvexView<double> view;
        project_convex(state.scene.camera, in.points + i * points * 3, points, view);
        const double tau = in.tau[i], kappa = in.kappa[i], rho = kappa / tau;
        double gA[kMaxPoints], gB[kMaxPoints], gC[kMaxPoints], dpoints[3 * kMaxPoints] = {}, dtau = 0, dkappa = 0;
        for (int e = 0; e < record.n; ++e) {  // E = 2^(rho lse), alpha = opacity / (1 + E)
            gA[e] = -kLn2 * rho * s[6 + 3 * e], gB[e] = -kLn2 * rho * s[7 + 3 * e], gC[e] = -kLn2 * rho * s[8 + 3 * e];
        }
        project_convex_backward(state.scene.camera, view, in.points + i * points * 3, tau, kappa, record.x0, record.y0, gA, gB, gC,
                                -kLn2 * s[5], s[3], dpoints, dtau, dkappa, camera);
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

}  // namespace

void backward(const State& state, const FrameGrad& grad, const SceneGrad& out, int threads) {
    Buffer<float> slots;
    Buffer<uint8_t> touched;
    Clock clock;
    blend_backward(state, grad, slots, touched, out.background, threads);
    clock(state.seconds.blend_backward);

    const int64_t n = int64_t(state.depth.size());
    const Reducer reducer{state, out, slots.data(), touched.data(), grad.extras != nullptr};
    std::vector<CameraGrad<double>> parts((n + kGrain - 1) / kGrain);
    parallel_blocks(n, kGrain, threads, [&](int64_t first, int64_t last, int64_t block) {
        CameraGrad<double> camera{};
        for (int64_t k = first; k < last; ++k) {
            if (state.slot_begin[k] == state.slot_begin[k + 1]) continue;  // culled, or in no tile: its record may be empty
            k < state.scene.gaussians.n ? reducer.gaussian(k, camera) : reducer.convex(k, camera);
        }
        parts[block] = camera;
    });
    clock(state.seconds.reduce);
    if (!out.camera) return;
    for (int i = 0; i < 16; ++i) out.camera[i] = 0;
    for (const CameraGrad<double>& p : parts) {
        out.camera[0] += p.fx, out.camera[1] += p.fy, out.camera[2] += p.cx, out.camera[3] += p.cy;
        for (int i = 0; i < 3; ++i) {
            for (int j = 0; j < 3; ++j) out.camera[4 + 4 * i + j] += p.R[3 * i + j];
            out.camera[4 + 4 * i + 3] += p.t[i];
        }
    }
}

}  // namespace e4dgs
