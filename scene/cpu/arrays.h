// Arrays that cross the border between Python and C++, and a check of their shape.
#pragma once
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <initializer_list>
#include <stdexcept>
#include <string>
#include <vector>

namespace nb = nanobind;
using In = nb::ndarray<const float, nb::c_contig, nb::device::cpu>;
using Out = nb::ndarray<float, nb::c_contig, nb::device::cpu>;
using Ins = std::vector<In>;
using Outs = std::vector<Out>;

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
