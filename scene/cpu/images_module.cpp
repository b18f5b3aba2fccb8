#include "images_module.h"

#include <nanobind/stl/array.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/pair.h>

#include <algorithm>
#include <array>
#include <cstdint>
#include <optional>
#include <stdexcept>
#include <string>
#include <utility>

#include "appearance.h"
#include "arrays.h"
#include "patch_match.h"
#include "photometric.h"
#include "surface.h"

namespace {

using Flags = nb::ndarray<const bool, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
using Maybe = std::optional<In>;

// x and y [H,W,3], and what goes with them; kept until the call has ended.
struct Compared {
    size_t h, w;
    const float* weight;
    bool recorded;
    e4dgs::Recording recording;
    Compared(const In& x, const In& y, const Maybe& weights, const Maybe& gain, const Maybe& offset, const Out& grad, const Out& d_gain, const Out& d_offset);
};

// The data of an optional image [h, w], or null.
const float* image_of(const Maybe& image, size_t h, size_t w, const char* name) {
    if (image) check(*image, {h, w}, name);
    return image ? image->data() : nullptr;
}

Compared::Compared(const In& x, const In& y, const Maybe& weights, const Maybe& gain, const Maybe& offset, const Out& grad, const Out& d_gain,
                   const Out& d_offset)
    : recorded(bool(gain)) {
    if (x.ndim() != 3 || x.shape(2) != 3) throw std::invalid_argument("x must be [H,W,3]");
    h = x.shape(0), w = x.shape(1);
    check(y, {h, w, 3}, "y"), check(grad, {h, w, 3}, "grad");
    check(d_gain, {3}, "d_gain"), check(d_offset, {3}, "d_offset");
    if (bool(gain) != bool(offset)) throw std::invalid_argument("gain and offset must be given together");
    weight = image_of(weights, h, w, "weight");
    if (!gain) return;
    check(*gain, {3}, "gain"), check(*offset, {3}, "offset");
    std::copy_n(gain->data(), 3, recording.gain), std::copy_n(offset->data(), 3, recording.offset);
}

}  // namespace

void bind_images(nb::module_& m) {
    m.def(
        "photometric",
        [](const In& x, const In& y, const Maybe& weight, const Maybe& gain, const Maybe& offset, float w_l1, float w_ssim, const Out& grad,
           const Out& d_gain, const Out& d_offset, int threads) {
            const Compared in(x, y, weight, gain, offset, grad, d_gain, d_offset);
            e4dgs::Photometric result;
            {
                nb::gil_scoped_release release;
                result = e4dgs::photometric(x.data(), y.data(), in.weight, in.recorded ? &in.recording : nullptr, int(in.h), int(in.w), w_l1, w_ssim,
                                            grad.data(), threads);
            }
            std::copy_n(result.d_gain, 3, d_gain.data()), std::copy_n(result.d_offset, 3, d_offset.data());
            return std::make_pair(result.l1, result.ssim);
        },
        nb::arg("x"), nb::arg("y"), nb::arg("weight").none(), nb::arg("gain").none(), nb::arg("offset").none(), nb::arg("w_l1"), nb::arg("w_ssim"),
        nb::arg("grad"), nb::arg("d_gain"), nb::arg("d_offset"), nb::arg("threads"));

    m.def(
        "appearance",
        [](const In& x, const In& y, const Maybe& weight, const Maybe& gain, const Maybe& offset, float w_l1, float w_ssim, const In& alpha, const In& known,
           const std::optional<Flags>& kept, std::array<float, 3> change, float share, float w_alpha, const Out& grad, const Out& grad_alpha,
           const Out& d_gain, const Out& d_offset, int threads) {
            const Compared in(x, y, weight, gain, offset, grad, d_gain, d_offset);
            check(alpha, {in.h, in.w}, "alpha"), check(known, {in.h, in.w}, "known"), check(grad_alpha, {in.h, in.w}, "grad_alpha");
            if (kept && (kept->shape(0) != in.h || kept->shape(1) != in.w)) throw std::invalid_argument("kept must be [H,W]");
            const e4dgs::Opposite other{alpha.data(), known.data(), kept ? kept->data() : nullptr, {change[0], change[1], change[2]}, share, w_alpha};
            e4dgs::Appearance result;
            {
                nb::gil_scoped_release release;
                result = e4dgs::appearance(x.data(), y.data(), in.weight, in.recorded ? &in.recording : nullptr, other, int(in.h), int(in.w), w_l1, w_ssim,
                                           grad.data(), grad_alpha.data(), threads);
            }
            std::copy_n(result.d_gain, 3, d_gain.data()), std::copy_n(result.d_offset, 3, d_offset.data());
            return result.loss;
        },
        nb::arg("x"), nb::arg("y"), nb::arg("weight").none(), nb::arg("gain").none(), nb::arg("offset").none(), nb::arg("w_l1"), nb::arg("w_ssim"),
        nb::arg("alpha"), nb::arg("known"), nb::arg("kept").none(), nb::arg("change"), nb::arg("share"), nb::arg("w_alpha"), nb::arg("grad"),
        nb::arg("grad_alpha"), nb::arg("d_gain"), nb::arg("d_offset"), nb::arg("threads"));

    m.def(
        "surface",
        [](const In& depth, const In& alpha, const In& image, const Maybe& measured, const std::optional<Flags>& moving, const Maybe& weight,
           float unit, float smooth, float measure, const Out& d_depth, const Out& d_alpha, int threads) {
            if (depth.ndim() != 2) throw std::invalid_argument("depth must be [H,W]");
            const size_t h = depth.shape(0), w = depth.shape(1);
            check(alpha, {h, w}, "alpha"), check(image, {h, w, 3}, "image"), check(d_depth, {h, w}, "d_depth"), check(d_alpha, {h, w}, "d_alpha");
            if (moving && (moving->shape(0) < 1 || moving->shape(1) < 1)) throw std::invalid_argument("moving must not be empty");
            const e4dgs::SurfaceInput in{depth.data(), alpha.data(), image.data(), image_of(measured, h, w, "measured"),
                                         moving ? reinterpret_cast<const uint8_t*>(moving->data()) : nullptr, image_of(weight, h, w, "weight"),
                                         int(h), int(w), moving ? int(moving->shape(0)) : 0, moving ? int(moving->shape(1)) : 0, unit, smooth, measure};
            nb::gil_scoped_release release;
            return e4dgs::surface(in, d_depth.data(), d_alpha.data(), threads);
        },
        nb::arg("depth"), nb::arg("alpha"), nb::arg("image"), nb::arg("measured").none(), nb::arg("moving").none(), nb::arg("weight").none(),
        nb::arg("unit"), nb::arg("smooth"), nb::arg("measure"), nb::arg("d_depth"), nb::arg("d_alpha"), nb::arg("threads"));

    m.def(
        "patch_match",
        [](const In& image, const In& others, const In& to, int best, std::pair<float, float> range, float step, float focal, int iterations,
           const std::optional<Flags>& wanted, const Out& planes, const Out& score, int threads) {
            if (image.ndim() != 2 || image.shape(0) < 2 || image.shape(1) < 2) throw std::invalid_argument("image must be [H,W], 2 px or more");
            const size_t h = image.shape(0), w = image.shape(1), n = others.ndim() == 3 ? others.shape(0) : 0;
            if (n < 1 || n > size_t(e4dgs::kMostOthers))
                throw std::invalid_argument("others must be [N,H,W] with 1 to " + std::to_string(e4dgs::kMostOthers) + " images");
            check(others, {n, h, w}, "others"), check(to, {n, 3, 4}, "to"), check(planes, {3, h, w}, "planes"), check(score, {h, w}, "score");
            if (wanted && (wanted->shape(0) != h || wanted->shape(1) != w)) throw std::invalid_argument("wanted must be [H,W]");
            if (best < 1 || iterations < 0) throw std::invalid_argument("best must be at least 1 and iterations at least 0");
            const e4dgs::Patches in{image.data(), others.data(), to.data(), int(n), best, int(h), int(w),
                                   range.first, range.second, step, focal, wanted ? wanted->data() : nullptr};
            nb::gil_scoped_release release;
            e4dgs::patch_match(in, iterations, planes.data(), score.data(), threads);
        },
        nb::arg("image"), nb::arg("others"), nb::arg("to"), nb::arg("best"), nb::arg("range"), nb::arg("step"), nb::arg("focal"),
        nb::arg("iterations"), nb::arg("wanted").none(), nb::arg("planes"), nb::arg("score"), nb::arg("threads"));
}
