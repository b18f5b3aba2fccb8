#pragma once
#include <nanobind/nanobind.h>

void bind_lives(nanobind::module_& m);  // lives_forward, lives_backward
