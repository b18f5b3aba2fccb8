#include "driver.h"

#include <dlfcn.h>

#include <array>
#include <cstdint>
#include <cstring>

namespace nb = nanobind;

namespace e4dgs {
namespace {

// The one function of the driver that is needed. It is looked up at run time, so that neither building nor importing this module wants CUDA.
using Launch = int (*)(void* kernel, unsigned grid_x, unsigned grid_y, unsigned grid_z, unsigned block_x, unsigned block_y, unsigned block_z,
                       unsigned shared_bytes, void* stream, void** parameters, void** extra);

Launch driver_launch() {
    static const Launch found = [] {
        void* driver = dlopen("libcuda.so.1", RTLD_NOW | RTLD_LOCAL);
        return driver ? reinterpret_cast<Launch>(dlsym(driver, "cuLaunchKernel")) : nullptr;
    }();
    return found;
}

constexpr size_t kMost = 64;  // arguments of a kernel

// What the arguments of a launch are read with; made once, and never freed.
struct Reader {
    PyTypeObject *tensor, *c_float, *c_double, *c_uint64;
    PyObject *get_device, *is_contiguous, *data_ptr, *value;
};

Reader* reader = nullptr;

nb::object call(PyObject* self, PyObject* method) {
    PyObject* const given[] = {self};
    return nb::steal(PyObject_VectorcallMethod(method, given, 1 | PY_VECTORCALL_ARGUMENTS_OFFSET, nullptr));
}

// Writes what the kernel gets of this argument into `slot`: an address, or a number in its own width (the driver reads no more than the
// parameter's). False if it is no argument for a kernel on this device.
bool read(PyObject* argument, int device, uint64_t& slot) {
    slot = 0;
    if (argument == Py_None) return true;
    if (PyType_IsSubtype(Py_TYPE(argument), reader->tensor)) {
        const nb::object there = call(argument, reader->get_device), dense = call(argument, reader->is_contiguous);
        if (!there.is_valid() || !dense.is_valid()) return false;
        if (PyLong_AsLong(there.ptr()) != device || dense.ptr() != Py_True) return false;
        const nb::object address = call(argument, reader->data_ptr);
        if (!address.is_valid()) return false;
        slot = PyLong_AsUnsignedLongLong(address.ptr());
        return !PyErr_Occurred();
    }
    const nb::object value = nb::steal(PyObject_GetAttr(argument, reader->value));
    if (!value.is_valid()) return false;
    if (Py_TYPE(argument) == reader->c_float) {
        const float number = float(PyFloat_AsDouble(value.ptr()));
        std::memcpy(&slot, &number, sizeof number);
    } else if (Py_TYPE(argument) == reader->c_double) {
        const double number = PyFloat_AsDouble(value.ptr());
        std::memcpy(&slot, &number, sizeof number);
    } else if (Py_TYPE(argument) == reader->c_uint64) {
        slot = PyLong_AsUnsignedLongLong(value.ptr());
    } else {
        const long long number = PyLong_AsLongLong(value.ptr());
        std::memcpy(&slot, &number, sizeof number);
    }
    return !PyErr_Occurred();
}

int launch(uint64_t kernel, unsigned blocks, unsigned threads, uint64_t stream, int device, nb::tuple arguments) {
    std::array<uint64_t, kMost> slots;
    std::array<void*, kMost> parameters;
    const size_t count = arguments.size();
    if (!reader || count > kMost) return -1;
    for (size_t i = 0; i < count; ++i) {
        if (!read(arguments[i].ptr(), device, slots[i])) {
            PyErr_Clear();
            return -1;
        }
        parameters[i] = &slots[i];
    }
    return driver_launch()(reinterpret_cast<void*>(kernel), blocks, 1, 1, threads, 1, 1, 0, reinterpret_cast<void*>(stream), parameters.data(), nullptr);
}

bool can_launch(nb::handle tensor, nb::handle c_float, nb::handle c_double, nb::handle c_uint64) {
    if (!driver_launch()) return false;
    if (!reader) {
        const auto type = [](nb::handle one) { return reinterpret_cast<PyTypeObject*>(one.inc_ref().ptr()); };
        const auto name = PyUnicode_InternFromString;
        reader = new Reader{type(tensor),       type(c_float),          type(c_double), type(c_uint64), name("get_device"),
                            name("is_contiguous"), name("data_ptr"), name("value")};
    }
    return true;
}

}  // namespace

void add_launching(nb::module_& m) {
    m.def("can_launch", &can_launch, nb::arg("tensor"), nb::arg("c_float"), nb::arg("c_double"), nb::arg("c_uint64"),
          "Whether there is a driver; call it with these types before the first launch.");
    m.def("launch", &launch, nb::arg("kernel"), nb::arg("blocks"), nb::arg("threads"), nb::arg("stream"), nb::arg("device"), nb::arg("arguments"),
          "Launch a kernel (CUkernel) with arguments as the Launcher takes them. The driver's status, 0 for success; -1 if an argument is none.");
}

}  // namespace e4dgs
