// Launches CUDA kernels from C++: through cuda-core and Python's ctypes a launch takes 20 us, of which the driver takes 3.
#pragma once
#include <nanobind/nanobind.h>

namespace e4dgs {

// Adds `launch` and `can_launch` to the module.
void add_launching(nanobind::module_& m);

}  // namespace e4dgs
