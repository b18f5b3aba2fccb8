// The Python interface of the losses on images.
#pragma once
#include <nanobind/nanobind.h>

void bind_images(nanobind::module_& m);
