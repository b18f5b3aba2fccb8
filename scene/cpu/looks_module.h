#pragma once
#include <nanobind/nanobind.h>

void bind_looks(nanobind::module_& m);
