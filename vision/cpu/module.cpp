#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include <initializer_list>
#include <stdexcept>
#include <string>
#include <vector>

#include "arrivals.h"
#include "correlate.h"

namespace nb = nanobind;
using In = nb::ndarray<const float, nb::c_contig, nb::device::cpu>;
using Out = nb::ndarray<float, nb::c_contig, nb::device::cpu>;

namespace {

using Ins = std::vector<In>;

template <class A>
void check(const A& array, std::initializer_list<size_t> shape, const char* name) {
    bool good = array.ndim() == shape.size();
    std::string wanted;
    size_t axis = 0;
    for (size_t n : shape) {
        good = good && array.shape(axis++) == n;
        wanted.append(wanted.empty() ? "" : ",").append(std::to_string(n));
    }
    if (!good) throw std::invalid_argument(std::string(name) + " must be [" + wanted + "]");
}

}  // namespace

NB_MODULE(_kernels, m) {
    m.def("arrivals", [](const In& flow, const Out& out) {
        if (flow.ndim() != 3 || flow.shape(2) != 2 || flow.shape(0) > 65536 || flow.shape(1) > 65536) throw std::invalid_argument("flow must be [H,W,2]");
        check(out, {flow.shape(0), flow.shape(1)}, "out");
        nb::gil_scoped_release release;
        e4dgs::arrivals(flow.data(), int(flow.shape(0)), int(flow.shape(1)), out.data());
    });

    m.def("correlate", [](const In& first, const Ins& levels, const In& at, int radius, const Out& out, int threads) {
        if (first.ndim() != 2 || radius < 1 || radius > e4dgs::kMaxRadius) throw std::invalid_argument("first must be [N,C], radius 1 to 8");
        const size_t n = first.shape(0), c = first.shape(1), side = size_t(2 * radius + 1);
        std::vector<e4dgs::CorrelationLevel> found;
        for (const In& level : levels) {
            if (level.ndim() != 3 || level.shape(2) != c || level.shape(0) > 65536 || level.shape(1) > 65536)
                throw std::invalid_argument("levels must be [H,W,C] with the channels of first, H and W at most 65536");
            found.push_back({level.data(), int(level.shape(0)), int(level.shape(1))});
        }
        check(at, {n, 2}, "at"), check(out, {n, levels.size() * side * side}, "out");
        nb::gil_scoped_release release;
        e4dgs::correlate(first.data(), found.data(), int(found.size()), at.data(), int64_t(n), int(c), radius, out.data(), threads);
    });
}
