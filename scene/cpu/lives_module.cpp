#include "lives_module.h"

#include <nanobind/stl/optional.h>
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <cstdint>
#include <optional>

#include "arrays.h"
#include "in_view.h"
#include "lives.h"

namespace {

using Flags = nb::ndarray<const bool, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using Maybe = std::optional<In>;

const float* quats_of(const Maybe& quats, size_t n, const char* name) {
    if (quats) check(*quats, {n, 4}, name);
    return quats ? quats->data() : nullptr;
}

// life: times [N], log_spans [N], velocities [N,3], spins [N,3]
e4dgs::Lives lives_of(const In& points, const Maybe& quats, const In& opacities, const Ins& life, const Flags& dynamic, float frame) {
    if (points.ndim() != 3 || points.shape(1) < 1 || points.shape(2) != 3) throw std::invalid_argument("points must be [N,corners,3]");
    if (life.size() != 4) throw std::invalid_argument("life must be times, log_spans, velocities, spins");
    const size_t n = points.shape(0);
    check(opacities, {n}, "opacities"), check(life[0], {n}, "times"), check(life[1], {n}, "log_spans");
    check(life[2], {n, 3}, "velocities"), check(life[3], {n, 3}, "spins");
    if (dynamic.shape(0) != n) throw std::invalid_argument("dynamic must be [N]");
    return {int64_t(n), int64_t(points.shape(1)), points.data(), quats_of(quats, n, "quats"), opacities.data(),
            life[0].data(), life[1].data(), life[2].data(), life[3].data(), dynamic.data(), frame};
}

using Tiles = nb::ndarray<const bool, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
using Doubles = nb::ndarray<const double, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using Index = nb::ndarray<int64_t, nb::ndim<1>, nb::c_contig, nb::device::cpu>;

}  // namespace

void bind_lives(nb::module_& m) {
    m.def(
        "lives_forward",
        [](const In& points, const Maybe& quats, const In& opacities, const Ins& life, const Flags& dynamic, float frame, const Out& moved,
           const std::optional<Out>& turned, const Out& shown, int threads) {
            const e4dgs::Lives in = lives_of(points, quats, opacities, life, dynamic, frame);
            const size_t n = points.shape(0);
            check(moved, {n, points.shape(1), 3}, "moved"), check(shown, {n}, "shown");
            if (turned.has_value() != quats.has_value()) throw std::invalid_argument("turned must be given with quats, and only then");
            if (turned) check(*turned, {n, 4}, "turned");
            const e4dgs::Shown<float> out{moved.data(), turned ? turned->data() : nullptr, shown.data()};
            nb::gil_scoped_release release;
            e4dgs::lives_forward(in, out, threads);
        },
        nb::arg("points"), nb::arg("quats").none(), nb::arg("opacities"), nb::arg("life"), nb::arg("dynamic"), nb::arg("frame"), nb::arg("moved"),
        nb::arg("turned").none(), nb::arg("shown"), nb::arg("threads"));

    m.def(
        "lives_backward",
        [](const In& points, const Maybe& quats, const In& opacities, const Ins& life, const Flags& dynamic, float frame, const In& g_moved,
           const Maybe& g_turned, const In& g_shown, const Out& g_points, const std::optional<Out>& g_quats, const Out& g_opacities,
           const Outs& g_life, int threads) {
            const e4dgs::Lives in = lives_of(points, quats, opacities, life, dynamic, frame);
            const size_t n = points.shape(0), corners = points.shape(1);
            check(g_moved, {n, corners, 3}, "g_moved"), check(g_shown, {n}, "g_shown");
            check(g_points, {n, corners, 3}, "g_points"), check(g_opacities, {n}, "g_opacities");
            if (g_turned.has_value() != quats.has_value() || g_quats.has_value() != quats.has_value())
                throw std::invalid_argument("g_turned and g_quats must be given with quats, and only then");
            const e4dgs::Shown<const float> grad{g_moved.data(), quats_of(g_turned, n, "g_turned"), g_shown.data()};
            if (g_quats) check(*g_quats, {n, 4}, "g_quats");
            if (g_life.size() != 4) throw std::invalid_argument("g_life must be of times, log_spans, velocities, spins");
            check(g_life[0], {n}, "g_times"), check(g_life[1], {n}, "g_log_spans"), check(g_life[2], {n, 3}, "g_velocities");
            check(g_life[3], {n, 3}, "g_spins");
            const e4dgs::LivesGrad out{g_points.data(), g_quats ? g_quats->data() : nullptr, g_opacities.data(), g_life[0].data(),
                                       g_life[1].data(), g_life[2].data(), g_life[3].data()};
            nb::gil_scoped_release release;
            e4dgs::lives_backward(in, grad, out, threads);
        },
        nb::arg("points"), nb::arg("quats").none(), nb::arg("opacities"), nb::arg("life"), nb::arg("dynamic"), nb::arg("frame"), nb::arg("g_moved"),
        nb::arg("g_turned").none(), nb::arg("g_shown"), nb::arg("g_points"), nb::arg("g_quats").none(), nb::arg("g_opacities"), nb::arg("g_life"),
        nb::arg("threads"));

    // life: times, log_spans, velocities; empty if nothing moves. camera: fx fy cx cy near, then the 3x4 of cam_from_world.
    m.def(
        "in_view",
        [](const In& means, const In& log_scales, const In& opacity_logits, const Ins& life, const Flags& dynamic, float frame, float fuller,
           const Doubles& camera,
           int width, int height, const std::optional<Tiles>& tiles, int tile, const Index& index, int threads) {
            const size_t n = means.ndim() ? means.shape(0) : 0;
            check(means, {n, 3}, "means"), check(log_scales, {n, 3}, "log_scales"), check(opacity_logits, {n}, "opacity_logits");
            if (!life.empty()) {
                if (life.size() != 3) throw std::invalid_argument("life must be times, log_spans, velocities, or empty");
                check(life[0], {n}, "times"), check(life[1], {n}, "log_spans"), check(life[2], {n, 3}, "velocities");
            }
            if (dynamic.shape(0) != n || index.shape(0) != n) throw std::invalid_argument("dynamic and index must be [N]");
            if (camera.shape(0) != 17 || width < 1 || height < 1 || tile < 1) throw std::invalid_argument("camera must be [17], for an image with pixels");
            e4dgs::ViewedGaussians gaussians{int64_t(n), means.data(), log_scales.data(), opacity_logits.data(), nullptr, nullptr, nullptr, dynamic.data(), frame, fuller};
            if (!life.empty()) gaussians.times = life[0].data(), gaussians.log_spans = life[1].data(), gaussians.velocities = life[2].data();
            e4dgs::Seeing view{};
            const double* from = camera.data();
            view.fx = from[0], view.fy = from[1], view.cx = from[2], view.cy = from[3], view.near = from[4];
            std::copy_n(from + 5, 12, view.pose);
            view.width = width, view.height = height, view.tile = tile;
            view.rows = (height + tile - 1) / tile, view.columns = (width + tile - 1) / tile;
            if (tiles && (tiles->shape(0) != size_t(view.rows) || tiles->shape(1) != size_t(view.columns)))
                throw std::invalid_argument("tiles must cover the image");
            view.tiles = tiles ? tiles->data() : nullptr;
            nb::gil_scoped_release release;
            return e4dgs::in_view(gaussians, view, index.data(), threads);
        },
        nb::arg("means"), nb::arg("log_scales"), nb::arg("opacity_logits"), nb::arg("life"), nb::arg("dynamic"), nb::arg("frame"), nb::arg("fuller"), nb::arg("camera"),
        nb::arg("width"), nb::arg("height"), nb::arg("tiles").none(), nb::arg("tile"), nb::arg("index"), nb::arg("threads"));
}
