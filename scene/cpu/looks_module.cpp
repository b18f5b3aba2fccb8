#include "looks_module.h"

#include <nanobind/stl/optional.h>
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <optional>
#include <string>
#include <type_traits>

#include "arrays.h"
#include "looks.h"

namespace {

using Maybe = std::optional<In>;
using MaybeOut = std::optional<Out>;

template <class A>
auto pointer(const std::optional<A>& array, std::initializer_list<size_t> shape, const char* name) -> decltype(array->data()) {
    if (array) check(*array, shape, name);
    return array ? array->data() : nullptr;
}

// given: logs [N,width], others [N], logits [N], dc [N,1,3], rest [N,stored,3], shades [N,courses], light [courses]
e4dgs::Looks looks_of(const std::vector<Maybe>& given, int64_t shown) {
    if (given.size() != 7 || !given[0] || !given[2] || !given[3] || !given[4])
        throw std::invalid_argument("looks take logs, others, logits, dc, rest, shades, light, of which others, shades and light may be None");
    const In &logs = *given[0], &logits = *given[2], &rest = *given[4];
    const size_t n = logits.ndim() == 1 ? logits.shape(0) : 0;
    check(logits, {n}, "logits"), check(*given[3], {n, 1, 3}, "dc");
    if (logs.ndim() < 1 || logs.ndim() > 2 || logs.shape(0) != n) throw std::invalid_argument("logs must be [N] or [N,width]");
    if (rest.ndim() != 3 || rest.shape(0) != n || rest.shape(2) != 3 || shown < 0 || size_t(shown) > rest.shape(1))
        throw std::invalid_argument("rest must be [N,R,3] with R of at least `shown`");
    if (bool(given[5]) != bool(given[6])) throw std::invalid_argument("shades and light must be given together");
    const size_t width = logs.ndim() == 2 ? logs.shape(1) : 1, courses = given[6] ? given[6]->size() : 0;
    const float* others = pointer(given[1], {n}, "others");
    const float *shades = pointer(given[5], {n, courses}, "shades"), *light = pointer(given[6], {courses}, "light");
    return {int64_t(n), int64_t(width), int64_t(rest.shape(1)), shown, int64_t(courses), logs.data(), others, logits.data(), given[3]->data(), rest.data(),
            shades, light};
}

void same_size(const MaybeOut& array, int64_t size, const char* name) {
    if (array && int64_t(array->size()) != size) throw std::invalid_argument(std::string(name) + " has another size than what it belongs to");
}

template <class A>
auto drawn_of(const e4dgs::Looks& in, const std::vector<std::optional<A>>& given, const char* name) -> e4dgs::Drawn<std::remove_pointer_t<decltype(given[0]->data())>> {
    if (given.size() != 4) throw std::invalid_argument(std::string(name) + " must be sizes, other sizes, opacities, sh");
    const int64_t sizes[] = {in.n * in.width, in.n, in.n, in.n * 3 * (1 + in.shown)};
    for (int k = 0; k < 4; ++k)
        if (given[k] && int64_t(given[k]->size()) != sizes[k]) throw std::invalid_argument(std::string(name) + " do not have the sizes of what they belong to");
    const auto data = [&given](int k) { return given[k] ? given[k]->data() : nullptr; };
    return {data(0), data(1), data(2), data(3)};
}

}  // namespace

void bind_looks(nb::module_& m) {
    m.def(
        "looks_forward",
        [](const std::vector<Maybe>& given, int64_t shown, const std::vector<MaybeOut>& out, int threads) {
            const e4dgs::Looks in = looks_of(given, shown);
            const auto to = drawn_of(in, out, "out");
            if (!in.n) return;  // of nothing, there are no addresses
            if (!to.sizes || !to.opacities || !to.sh || bool(to.other_sizes) != bool(in.others)) throw std::invalid_argument("out must have all that is given");
            nb::gil_scoped_release release;
            e4dgs::looks_forward(in, to, threads);
        },
        nb::arg("given"), nb::arg("shown"), nb::arg("out"), nb::arg("threads"));
    m.def(
        "looks_backward",
        [](const std::vector<Maybe>& given, int64_t shown, const std::vector<Maybe>& out, const std::vector<Maybe>& grads, const std::vector<MaybeOut>& back,
           int threads) {
            const e4dgs::Looks in = looks_of(given, shown);
            const auto drawn = drawn_of(in, out, "out"), incoming = drawn_of(in, grads, "grads");
            if (back.size() != 7) throw std::invalid_argument("back must have a gradient for each of what is given");
            const int64_t sizes[] = {in.n * in.width, in.n, in.n, 3 * in.n, 3 * in.n * in.stored, in.n * in.courses, in.courses};
            for (int k = 0; k < 7; ++k) same_size(back[k], sizes[k], "back");
            const auto data = [&back](int k) { return back[k] ? back[k]->data() : nullptr; };
            const e4dgs::LooksGrad to{data(0), data(1), data(2), data(3), data(4), data(5), data(6)};
            if (!in.n) {
                if (back[6]) std::fill_n(back[6]->data(), in.courses, 0.0f);
                return;
            }
            const bool all = (!incoming.sizes || (to.logs && drawn.sizes)) && (!incoming.other_sizes || (to.others && drawn.other_sizes)) &&
                             (!incoming.opacities || (to.logits && drawn.opacities)) && (!incoming.sh || to.dc) && bool(to.shades) == bool(to.light) &&
                             (!to.shades || (in.light && incoming.sh));
            if (!all) throw std::invalid_argument("back and out must have what the incoming gradients belong to");
            nb::gil_scoped_release release;
            e4dgs::looks_backward(in, drawn, incoming, to, threads);
        },
        nb::arg("given"), nb::arg("shown"), nb::arg("out"), nb::arg("grads"), nb::arg("back"), nb::arg("threads"));
}
