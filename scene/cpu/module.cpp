#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/pair.h>

#include <stdexcept>
#include <utility>

#include "photometric.h"
#include "planes.h"

namespace nb = nanobind;
using In = nb::ndarray<const float, nb::c_contig, nb::device::cpu>;
using Out = nb::ndarray<float, nb::c_contig, nb::device::cpu>;

namespace {

e4dgs::PlaneLevel level_of(const In& space, const In& time) {
    if (space.ndim() != 4 || space.shape(0) != 3 || space.shape(1) != space.shape(2)) throw std::invalid_argument("space must be [3,R,R,C]");
    if (time.ndim() != 4 || time.shape(0) != 3 || time.shape(2) != space.shape(1) || time.shape(3) != space.shape(3))
        throw std::invalid_argument("time must be [3,T,R,C] with the R and C of space");
    if (space.shape(3) > 64) throw std::invalid_argument("at most 64 channels");
    return {space.data(), time.data(), static_cast<int>(space.shape(1)), static_cast<int>(time.shape(1)), static_cast<int>(space.shape(3))};
}

void check_rows(const In& u, size_t rows, size_t columns, size_t offset, int channels) {
    if (u.ndim() != 2 || u.shape(1) != 3) throw std::invalid_argument("u must be [N,3]");
    if (rows != u.shape(0) || offset + static_cast<size_t>(channels) > columns) throw std::invalid_argument("features must be [N, >= offset + C]");
}

}  // namespace

NB_MODULE(_kernels, m) {
    m.doc() = "CPU kernels of e4dgs.scene: six-plane look-up, L1 + SSIM.";

    m.def("planes_forward", [](In space, In time, In u, float t, Out out, size_t offset, int threads) {
        const auto level = level_of(space, time);
        if (out.ndim() != 2) throw std::invalid_argument("out must be [N,F]");
        check_rows(u, out.shape(0), out.shape(1), offset, level.channels);
        nb::gil_scoped_release release;
        e4dgs::planes_forward(level, u.data(), static_cast<int64_t>(u.shape(0)), t, out.data(), static_cast<int64_t>(out.shape(1)),
                              static_cast<int64_t>(offset), threads);
    });

    m.def("planes_backward", [](In space, In time, In u, float t, In grad, size_t offset, Out grad_space, Out grad_time, int threads) {
        const auto level = level_of(space, time);
        if (grad.ndim() != 2) throw std::invalid_argument("grad must be [N,F]");
        check_rows(u, grad.shape(0), grad.shape(1), offset, level.channels);
        if (grad_space.size() != space.size() || grad_time.size() != time.size()) throw std::invalid_argument("gradients must have the planes' shapes");
        nb::gil_scoped_release release;
        e4dgs::planes_backward(level, u.data(), static_cast<int64_t>(u.shape(0)), t, grad.data(), static_cast<int64_t>(grad.shape(1)),
                               static_cast<int64_t>(offset), grad_space.data(), grad_time.data(), threads);
    });

    m.def("photometric", [](In x, In y, float w_l1, float w_ssim, Out grad, int threads) {
        if (x.ndim() != 3 || x.shape(2) != 3 || y.size() != x.size() || grad.size() != x.size()) throw std::invalid_argument("x, y, grad must be [H,W,3]");
        e4dgs::Photometric result;
        {
            nb::gil_scoped_release release;
            result = e4dgs::photometric(x.data(), y.data(), static_cast<int>(x.shape(0)), static_cast<int>(x.shape(1)), w_l1, w_ssim, grad.data(), threads);
        }
        return std::make_pair(result.l1, result.ssim);
    });
}
