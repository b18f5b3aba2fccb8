#include <nanobind/stl/array.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/pair.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <optional>
#include <stdexcept>
#include <string>
#include <tuple>
#include <utility>
#include <vector>

#include "adam.h"
#include "arrays.h"
#include "displacement.h"
#include "field.h"
#include "field_run.h"
#include "images_module.h"
#include "lives_module.h"
#include "looks_module.h"
#include "skinning.h"
#include "smoothness.h"

namespace {

using Rows = nb::ndarray<const int64_t, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using Box = std::pair<std::array<float, 3>, std::array<float, 3>>;  // low and high corner

// space [3,R,R,C] and time [3,T,R,C] of each level; weights w1 b1 w2 b2 w3 b3 in torch's layout, or none.
e4dgs::FieldInput field_of(const Ins& space, const Ins& time, const Ins& weights, const In& points, const Box& box, float t) {
    if (space.empty() || space.size() > size_t(e4dgs::kMaxLevels) || time.size() != space.size())
        throw std::invalid_argument("space and time must hold the same 1 to " + std::to_string(e4dgs::kMaxLevels) + " levels");
    e4dgs::FieldInput in;
    for (size_t l = 0; l < space.size(); ++l) {
        if (space[l].ndim() != 4 || space[l].shape(0) != 3 || space[l].shape(1) != space[l].shape(2) || space[l].shape(1) < 1)
            throw std::invalid_argument("space must be [3,R,R,C]");
        if (time[l].ndim() != 4 || time[l].shape(0) != 3 || time[l].shape(1) < 1 || time[l].shape(2) != space[l].shape(1) ||
            time[l].shape(3) != space[l].shape(3))
            throw std::invalid_argument("time must be [3,T,R,C] with the R and C of space");
        if (space[l].shape(3) != space[0].shape(3) || space[l].shape(3) < 1 || space[l].shape(3) > size_t(e4dgs::kMaxChannels))
            throw std::invalid_argument("levels must have the same number of channels, 1 to " + std::to_string(e4dgs::kMaxChannels));
        in.levels.push_back({space[l].data(), time[l].data(), int(space[l].shape(1)), int(time[l].shape(1))});
    }
    in.channels = int(space[0].shape(3));
    if (points.ndim() != 2 || points.shape(1) != 3) throw std::invalid_argument("points must be [N,3]");
    in.points = points.data(), in.n = int64_t(points.shape(0)), in.t = t;
    for (size_t axis = 0; axis < 3; ++axis) {
        in.low[axis] = box.first[axis], in.high[axis] = box.second[axis];
        if (!(in.high[axis] > in.low[axis])) throw std::invalid_argument("the box must have a positive size on every axis");
    }
    if (weights.empty()) return in;
    if (weights.size() != 6 || weights[0].ndim() != 2 || weights[4].ndim() != 2) throw std::invalid_argument("weights must be w1, b1, w2, b2, w3, b3");
    const size_t f = size_t(in.channels) * space.size(), w = weights[0].shape(0), o = weights[4].shape(0);
    if (w < 1 || w > 4096 || o < 1 || o > 4096) throw std::invalid_argument("layers must be 1 to 4096 wide");
    check(weights[0], {w, f}, "w1"), check(weights[1], {w}, "b1"), check(weights[2], {w, w}, "w2"), check(weights[3], {w}, "b2");
    check(weights[4], {o, w}, "w3"), check(weights[5], {o}, "b3");
    in.mlp = {int(w), int(o), weights[0].data(), weights[1].data(), weights[2].data(), weights[3].data(), weights[4].data(), weights[5].data()};
    return in;
}

e4dgs::Displacing displacing_of(const In& heads, const In& rest, std::array<float, 3> centre, float reach) {
    check(rest, {rest.shape(0), 3}, "rest"), check(heads, {rest.shape(0), 10}, "heads");
    return {heads.data(), rest.data(), int64_t(rest.shape(0)), {centre[0], centre[1], centre[2]}, reach};
}

using Links = nb::ndarray<const int32_t, nb::c_contig, nb::device::cpu>;
using LinksOut = nb::ndarray<int32_t, nb::c_contig, nb::device::cpu>;

// nodes: home [B,3], home_hyper [B,H], falloff [B], and for skinning also turns [B,4], shifts [B,3].
e4dgs::Skinning skinning_of(const In& rest, const In* quats, const In& rest_hyper, const Ins& nodes) {
    if (nodes.size() != 3 && nodes.size() != 5) throw std::invalid_argument("nodes must be home, home_hyper, falloff, turns, shifts");
    const size_t n = rest.shape(0), b = nodes[0].shape(0), h = rest_hyper.ndim() == 2 ? rest_hyper.shape(1) : 0;
    if (b < 1 || h > size_t(e4dgs::kMostHyper)) throw std::invalid_argument("there must be a node, and at most 4 hyper coordinates");
    check(rest, {n, 3}, "rest"), check(rest_hyper, {n, h}, "rest_hyper"), check(nodes[0], {b, 3}, "home"), check(nodes[1], {b, h}, "home_hyper");
    check(nodes[2], {b}, "falloff");
    if (quats) check(*quats, {n, 4}, "quats");
    e4dgs::Skinning in{};
    in.n = int64_t(n), in.nodes = int(b), in.hyper = int(h), in.rest = rest.data(), in.quats = quats ? quats->data() : nullptr, in.rest_hyper = rest_hyper.data();
    in.home = nodes[0].data(), in.home_hyper = nodes[1].data(), in.falloff = nodes[2].data();
    if (nodes.size() == 5) {
        check(nodes[3], {b, 4}, "turns"), check(nodes[4], {b, 3}, "shifts");
        in.turns = nodes[3].data(), in.shifts = nodes[4].data();
    }
    return in;
}

void link_to(e4dgs::Skinning& in, const Links& link) {
    if (link.ndim() != 2 || int64_t(link.shape(0)) != in.n || link.shape(1) < 1 || link.shape(1) > size_t(e4dgs::kMostLinks))
        throw std::invalid_argument("link must be [N,1 to 8] for the N of rest");
    uint32_t most = 0;  // negative numbers count as large ones; one test at the end, so that the loop is vectorised
    for (size_t i = 0; i < link.size(); ++i) most = std::max(most, uint32_t(link.data()[i]));
    if (link.size() && most >= uint32_t(in.nodes)) throw std::invalid_argument("link names a node that is not there");
    in.link = link.data(), in.links = int(link.shape(1));
}

size_t outputs_of(const e4dgs::FieldInput& in) { return in.mlp.outputs ? size_t(in.mlp.outputs) : size_t(in.channels) * in.levels.size(); }

// parameter, gradient, first and second moment, pace, index, number of the step, rate. index: the rows of parameter, first and second to which gradient
// and pace belong; None: all of them. pace: a factor on the rate of each row; None: 1.
using Rates = std::tuple<Out, In, Out, Out, std::optional<In>, std::optional<Rows>, int64_t, float>;

e4dgs::AdamRows adam_of(const Rates& one, float beta1, float beta2, float epsilon) {
    const auto& [parameter, gradient, first, second, pace, index, step, rate] = one;
    const size_t size = parameter.size(), rows = parameter.ndim() ? parameter.shape(0) : 1, width = rows ? size / rows : 0;
    const size_t given = index ? index->shape(0) : rows;
    if (gradient.size() != given * width || first.size() != size || second.size() != size)
        throw std::invalid_argument("gradient must have the shape of the rows it belongs to, moments that of the parameter");
    if (index && std::any_of(index->data(), index->data() + given, [rows = rows](int64_t row) { return row < 0 || size_t(row) >= rows; }))
        throw std::invalid_argument("index names a row that the parameter does not have");
    if (pace && pace->size() != given) throw std::invalid_argument("pace must have one number for each row of gradient");
    if (step < 1) throw std::invalid_argument("the first step is number 1");
    const auto correction = [number = step](float beta) { return float(1.0 - std::pow(double(beta), double(number))); };
    return {parameter.data(), first.data(), second.data(), gradient.data(), pace ? pace->data() : nullptr, index ? index->data() : nullptr,
            int64_t(given), int64_t(width), {rate, beta1, beta2, epsilon, correction(beta1), correction(beta2)}};
}

}  // namespace

NB_MODULE(_kernels, m) {
    m.doc() = "CPU kernels of e4dgs.scene: the deformation field, L1 + SSIM.";

    using Maybe = std::optional<In>;
    m.def(
        "field_forward",
        [](const Ins& space, const Ins& time, const Ins& weights, const In& points, const Box& box, float t, const Out& out,
           const std::optional<Out>& hidden, int threads) {
            const e4dgs::FieldInput in = field_of(space, time, weights, points, box, t);
            check(out, {points.shape(0), outputs_of(in)}, "out");
            if (hidden) check(*hidden, {size_t(e4dgs::hidden_floats(in))}, "hidden");
            float* keep = hidden ? hidden->data() : nullptr;
            nb::gil_scoped_release release;
            e4dgs::field_forward(in, out.data(), keep, threads);
        },
        nb::arg("space"), nb::arg("time"), nb::arg("weights"), nb::arg("points"), nb::arg("box"), nb::arg("t"), nb::arg("out"),
        nb::arg("hidden").none(), nb::arg("threads"));

    m.def("field_backward", [](const Ins& space, const Ins& time, const Ins& weights, const In& points, const Box& box, float t, const In& grad,
                               const In& hidden, const Outs& grad_space, const Outs& grad_time, const Outs& grad_weights, int threads) {
        const e4dgs::FieldInput in = field_of(space, time, weights, points, box, t);
        check(grad, {points.shape(0), outputs_of(in)}, "grad");
        check(hidden, {size_t(e4dgs::hidden_floats(in))}, "hidden");
        e4dgs::FieldGrad out;
        if (grad_space.size() != space.size() || grad_time.size() != time.size() || grad_weights.size() != weights.size())
            throw std::invalid_argument("gradients must be as many as their tensors");
        for (size_t l = 0; l < space.size(); ++l) {
            if (grad_space[l].size() != space[l].size() || grad_time[l].size() != time[l].size())
                throw std::invalid_argument("gradients must have the planes' shapes");
            out.space.push_back(grad_space[l].data()), out.time.push_back(grad_time[l].data());
        }
        for (size_t k = 0; k < weights.size(); ++k)
            if (grad_weights[k].size() != weights[k].size()) throw std::invalid_argument("gradients must have the weights' shapes");
        if (!weights.empty()) {
            float** to[6] = {&out.w1, &out.b1, &out.w2, &out.b2, &out.w3, &out.b3};
            for (int k = 0; k < 6; ++k) *to[k] = grad_weights[size_t(k)].data();
        }
        nb::gil_scoped_release release;
        e4dgs::field_backward(in, grad.data(), hidden.data(), out, threads);
    });

    m.def("displacement_forward", [](const In& heads, const In& rest, std::array<float, 3> centre, float reach, const Out& dx, const Out& dr,
                                     const Out& ds, int threads) {
        const size_t n = rest.shape(0);
        const e4dgs::Displacing in = displacing_of(heads, rest, centre, reach);
        check(dx, {n, 3}, "dx"), check(dr, {n, 4}, "dr"), check(ds, {n, 3}, "ds");
        nb::gil_scoped_release release;
        e4dgs::displacement_forward(in, dx.data(), dr.data(), ds.data(), threads);
    });
    m.def(
        "displacement_backward",
        [](const In& heads, const In& rest, std::array<float, 3> centre, float reach, const Maybe& g_dx, const Maybe& g_dr, const Maybe& g_ds,
           const Out& g_heads, const std::optional<Out>& g_rest, int threads) {
            const size_t n = rest.shape(0);
            const e4dgs::Displacing in = displacing_of(heads, rest, centre, reach);
            const auto pointer = [n](const Maybe& g, size_t width, const char* name) {
                if (g) check(*g, {n, width}, name);
                return g ? g->data() : nullptr;
            };
            const float *dx = pointer(g_dx, 3, "g_dx"), *dr = pointer(g_dr, 4, "g_dr"), *ds = pointer(g_ds, 3, "g_ds");
            check(g_heads, {n, 10}, "g_heads");
            if (g_rest) check(*g_rest, {n, 3}, "g_rest");
            float* to_rest = g_rest ? g_rest->data() : nullptr;
            nb::gil_scoped_release release;
            e4dgs::displacement_backward(in, dx, dr, ds, g_heads.data(), to_rest, threads);
        },
        nb::arg("heads"), nb::arg("rest"), nb::arg("centre"), nb::arg("reach"), nb::arg("g_dx").none(), nb::arg("g_dr").none(), nb::arg("g_ds").none(),
        nb::arg("g_heads"), nb::arg("g_rest").none(), nb::arg("threads"));

    m.def(
        "select_kernels", [](const std::string& name) { return e4dgs::select_field_kernels(name.c_str()); }, nb::arg("name"),
        "Use another instruction set for the field; False where the processor or the build lacks it.");

    m.def(
        "adam",
        [](const std::vector<Rates>& all, float beta1, float beta2, float epsilon, int threads) {
            std::vector<e4dgs::AdamRows> steps;
            for (const Rates& one : all) steps.push_back(adam_of(one, beta1, beta2, epsilon));
            nb::gil_scoped_release release;
            e4dgs::adam(steps, threads);
        },
        nb::arg("all"), nb::arg("beta1"), nb::arg("beta2"), nb::arg("epsilon"), nb::arg("threads"));

    m.def("smoothness", [](const Ins& space, const Ins& time, const Outs& grad_space, const Outs& grad_time, int threads) {
        std::vector<e4dgs::PlaneStack> stacks;
        const auto add = [&stacks](const Ins& planes, const Outs& grads, bool second) {
            if (planes.size() != grads.size()) throw std::invalid_argument("gradients must be as many as their planes");
            for (size_t l = 0; l < planes.size(); ++l) {
                if (planes[l].ndim() != 4 || planes[l].shape(0) != 3) throw std::invalid_argument("planes must be [3,rows,columns,C]");
                if (grads[l].size() != planes[l].size()) throw std::invalid_argument("gradients must have the planes' shapes");
                stacks.push_back({planes[l].data(), int64_t(planes[l].shape(1)), int64_t(planes[l].shape(2)), int64_t(planes[l].shape(3)), second, grads[l].data()});
            }
        };
        add(space, grad_space, false), add(time, grad_time, true);
        nb::gil_scoped_release release;
        return e4dgs::smoothness(stacks.data(), int(stacks.size()), threads);
    });

    m.def(
        "skin_forward",
        [](const In& rest, const In& quats, const In& rest_hyper, const Links& link, const Ins& nodes, const Out& moved, const Out& turned, int threads) {
            e4dgs::Skinning in = skinning_of(rest, &quats, rest_hyper, nodes);
            if (!in.turns) throw std::invalid_argument("nodes must hold turns and shifts");
            link_to(in, link);
            check(moved, {rest.shape(0), 3}, "moved"), check(turned, {rest.shape(0), 4}, "turned");
            nb::gil_scoped_release release;
            e4dgs::skin_forward(in, moved.data(), turned.data(), threads);
        },
        nb::arg("rest"), nb::arg("quats"), nb::arg("rest_hyper"), nb::arg("link"), nb::arg("nodes"), nb::arg("moved"), nb::arg("turned"),
        nb::arg("threads"));

    m.def(
        "skin_backward",
        [](const In& rest, const In& quats, const In& rest_hyper, const Links& link, const Ins& nodes, const In& g_moved, const In& g_turned,
           const Out& g_rest, const Out& g_quats, const Out& g_rest_hyper, const Outs& g_nodes, int threads) {
            e4dgs::Skinning in = skinning_of(rest, &quats, rest_hyper, nodes);
            if (!in.turns) throw std::invalid_argument("nodes must hold turns and shifts");
            link_to(in, link);
            const size_t n = rest.shape(0), b = nodes[0].shape(0), h = size_t(in.hyper);
            check(g_moved, {n, 3}, "g_moved"), check(g_turned, {n, 4}, "g_turned"), check(g_rest, {n, 3}, "g_rest"), check(g_rest_hyper, {n, h}, "g_rest_hyper");
            check(g_quats, {n, 4}, "g_quats");
            if (g_nodes.size() != 4) throw std::invalid_argument("g_nodes must be of home_hyper, falloff, turns, shifts");
            check(g_nodes[0], {b, h}, "g_home_hyper"), check(g_nodes[1], {b}, "g_falloff"), check(g_nodes[2], {b, 4}, "g_turns"), check(g_nodes[3], {b, 3}, "g_shifts");
            const e4dgs::SkinningGrad out{g_rest.data(), g_quats.data(), g_rest_hyper.data(), g_nodes[0].data(), g_nodes[1].data(),
                                          g_nodes[2].data(), g_nodes[3].data()};
            nb::gil_scoped_release release;
            e4dgs::skin_backward(in, g_moved.data(), g_turned.data(), out, threads);
        },
        nb::arg("rest"), nb::arg("quats"), nb::arg("rest_hyper"), nb::arg("link"), nb::arg("nodes"), nb::arg("g_moved"), nb::arg("g_turned"),
        nb::arg("g_rest"), nb::arg("g_quats"), nb::arg("g_rest_hyper"), nb::arg("g_nodes"), nb::arg("threads"));

    m.def("nearest_nodes", [](const In& rest, const In& rest_hyper, const Ins& nodes, const LinksOut& link, int threads) {
        e4dgs::Skinning in = skinning_of(rest, nullptr, rest_hyper, nodes);
        if (link.ndim() != 2 || int64_t(link.shape(0)) != in.n || link.shape(1) < 1 || link.shape(1) > std::min<size_t>(e4dgs::kMostLinks, size_t(in.nodes)))
            throw std::invalid_argument("link must be [N,1 to 8], at most one for each node");
        in.links = int(link.shape(1));
        nb::gil_scoped_release release;
        e4dgs::nearest_nodes(in, link.data(), threads);
    });

    bind_lives(m);
    bind_looks(m);
    bind_images(m);
}
