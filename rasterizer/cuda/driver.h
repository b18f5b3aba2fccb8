// Launches CUDA kernels from C++. Seen by Python's profiler, a launch takes 14 us, where reading its arguments in Python took 54.
#pragma once
#include <nanobind/nanobind.h>

namespace e4dgs {

// Adds `launch` and `can_launch` to the module.
void add_launching(nanobind::module_& m);

}  // namespace e4dgs
