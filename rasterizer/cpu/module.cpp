// The Python interface of the CPU kernels: takes dictionaries of arrays and fills arrays in place. Only cpu_backend.py calls it.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/unique_ptr.h>

#include <memory>
#include <stdexcept>
#include <string>
#include <vector>

#include "blend.h"
#include "../cuda/driver.h"
#include "state.h"

namespace nb = nanobind;
using namespace e4dgs;

namespace {

template <class T>
using Array = nb::ndarray<T, nb::c_contig, nb::device::cpu>;

// The array under `key`, which must have `size` elements; null if the dictionary has no such key or None. `held` keeps it alive.
template <class T>
T* array(const nb::dict& from, const char* key, int64_t size, std::vector<nb::object>* held = nullptr) {
    if (!from.contains(key) || nb::object(from[key]).is_none()) return nullptr;
    nb::object object = from[key];
    const auto a = nb::cast<Array<T>>(object);
    if (int64_t(a.size()) != size)
        throw std::invalid_argument(std::string(key) + " has " + std::to_string(a.size()) + " elements, expected " + std::to_string(size));
    if (held) held->push_back(nb::cast(a));
    return a.data();
}

int64_t length(const nb::dict& from, const char* key, int axis) { return int64_t(nb::cast<Array<float>>(from[key]).shape(axis)); }

// A frame's state, with the inputs that its backward pass reads.
struct Frame {
    State state;
    std::vector<nb::object> inputs;
};

void read_looks(const nb::dict& from, int64_t n, int extras, Looks& to, std::vector<nb::object>* held) {
    to.opacities = array<float>(from, "opacities", n, held);
    to.colors = array<float>(from, "colors", n * 3, held);
    if (!nb::object(from["sh"]).is_none()) {
        const int64_t k = length(from, "sh", 1);
        to.degree = k == 1 ? 0 : k == 4 ? 1 : k == 9 ? 2 : 3;
        to.sh = array<float>(from, "sh", n * (to.degree + 1) * (to.degree + 1) * 3, held);
    }
    to.extras = extras ? array<float>(from, "extras", n * extras, held) : nullptr;
}

void read_scene(const nb::dict& camera, const nb::dict& gaussians, const nb::dict& convexes, SceneInput& to, std::vector<nb::object>* held) {
    Camera<double>& cam = to.camera;
    const double *K = array<double>(camera, "K", 9), *pose = array<double>(camera, "cam_from_world", 12);
    const float* background = array<float>(camera, "background", 3);
    if (!K || !pose || !background) throw std::invalid_argument("camera wants K, cam_from_world and background");
    cam.fx = K[0], cam.fy = K[4], cam.cx = K[2], cam.cy = K[5];
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) cam.R[3 * i + j] = pose[4 * i + j];
        cam.t[i] = pose[4 * i + 3];
        to.background[i] = background[i];
    }
    cam.width = nb::cast<int>(camera["width"]), cam.height = nb::cast<int>(camera["height"]);
    cam.near_z = nb::cast<double>(camera["near"]);
    if (cam.width < 1 || cam.height < 1 || tiles_across(cam.width) > 65535 || tiles_across(cam.height) > 65535)
        throw std::invalid_argument("image of " + std::to_string(cam.width) + " x " + std::to_string(cam.height) + " pixels is out of range");
    complete(cam);
    to.extras = nb::cast<int>(camera["extras"]);
    to.antialiased = nb::cast<bool>(camera["antialiased"]);
    to.tiles = array<uint8_t>(camera, "tiles", int64_t(tiles_across(cam.width)) * tiles_across(cam.height), held);

    to.gaussians.n = length(gaussians, "means", 0);
    to.gaussians.means = array<float>(gaussians, "means", to.gaussians.n * 3, held);
    to.gaussians.quats = array<float>(gaussians, "quats", to.gaussians.n * 4, held);
    to.gaussians.scales = array<float>(gaussians, "scales", to.gaussians.n * 3, held);
    read_looks(gaussians, to.gaussians.n, to.extras, to.gaussians, held);
    to.convexes.n = length(convexes, "points", 0);
    to.convexes.points_each = int(length(convexes, "points", 1));
    if (to.convexes.points_each < 3 || to.convexes.points_each > kMaxPoints) throw std::invalid_argument("a convex has 3 to 8 points");
    to.convexes.points = array<float>(convexes, "points", to.convexes.n * to.convexes.points_each * 3, held);
    to.convexes.tau = array<float>(convexes, "tau", to.convexes.n, held);
    to.convexes.kappa = array<float>(convexes, "kappa", to.convexes.n, held);
    read_looks(convexes, to.convexes.n, to.extras, to.convexes, held);
    if (to.gaussians.n + to.convexes.n >= int64_t(0xffffffff)) throw std::invalid_argument("too many primitives");
}

std::unique_ptr<Frame> forward(const nb::dict& camera, const nb::dict& gaussians, const nb::dict& convexes, const nb::dict& frame, bool keep,
                               int threads) {
    auto result = std::make_unique<Frame>();
    State& state = result->state;
    read_scene(camera, gaussians, convexes, state.scene, keep ? &result->inputs : nullptr);
    const SceneInput& scene = state.scene;
    const int64_t pixels = int64_t(scene.camera.width) * scene.camera.height;
    FrameOutput out;
    out.color = array<float>(frame, "color", pixels * 3);
    out.alpha = array<float>(frame, "alpha", pixels);
    out.depth = array<float>(frame, "depth", pixels);
    out.extras = array<float>(frame, "extras", pixels * scene.extras);
    out.visible_gaussians = array<uint8_t>(frame, "visible_gaussians", scene.gaussians.n);
    out.visible_convexes = array<uint8_t>(frame, "visible_convexes", scene.convexes.n);
    state.tiles_x = tiles_across(scene.camera.width), state.tiles_y = tiles_across(scene.camera.height);
    {
        nb::gil_scoped_release released;
        preprocess(state, threads);
        find_spans(state, keep, threads);
        sort_by_depth(state, threads);
        distribute(state, threads);
        blend_forward(state, out, keep, threads);
    }
    return keep ? std::move(result) : nullptr;
}

void read_looks_grad(const nb::dict& from, const Looks& in, int64_t n, int extras, LooksGrad& to) {
    to.opacities = array<float>(from, "opacities", n);
    to.colors = array<float>(from, "colors", n * 3);
    to.sh = array<float>(from, "sh", n * (in.degree + 1) * (in.degree + 1) * 3);
    to.extras = array<float>(from, "extras", n * extras);
}

void backward_frame(const Frame& frame, const nb::dict& grad, const nb::dict& camera, const nb::dict& gaussians, const nb::dict& convexes,
                    int threads) {
    const SceneInput& scene = frame.state.scene;
    const int64_t pixels = int64_t(scene.camera.width) * scene.camera.height;
    FrameGrad in;
    in.color = array<float>(grad, "color", pixels * 3);
    in.alpha = array<float>(grad, "alpha", pixels);
    in.depth = array<float>(grad, "depth", pixels);
    in.extras = scene.extras ? array<float>(grad, "extras", pixels * scene.extras) : nullptr;
    in.alpha_image = array<float>(grad, "alpha_image", pixels);
    in.depth_image = array<float>(grad, "depth_image", pixels);
    if (in.depth && (!in.alpha_image || !in.depth_image)) throw std::invalid_argument("a gradient of depth wants the frame's alpha and depth");
    SceneGrad out;
    out.camera = array<double>(camera, "camera", 16);
    out.background = array<double>(camera, "background", 3);
    out.gaussians.means = array<float>(gaussians, "means", scene.gaussians.n * 3);
    out.gaussians.quats = array<float>(gaussians, "quats", scene.gaussians.n * 4);
    out.gaussians.scales = array<float>(gaussians, "scales", scene.gaussians.n * 3);
    read_looks_grad(gaussians, scene.gaussians, scene.gaussians.n, scene.extras, out.gaussians);
    out.convexes.points = array<float>(convexes, "points", scene.convexes.n * scene.convexes.points_each * 3);
    out.convexes.tau = array<float>(convexes, "tau", scene.convexes.n);
    out.convexes.kappa = array<float>(convexes, "kappa", scene.convexes.n);
    read_looks_grad(convexes, scene.convexes, scene.convexes.n, scene.extras, out.convexes);
    nb::gil_scoped_release released;
    backward(frame.state, in, out, threads);
}

}  // namespace

NB_MODULE(_cpu, m) {
    m.doc() = "CPU kernels of e4dgs.rasterizer.";
    nb::set_leak_warnings(false);  // an autograd graph that is still alive when Python exits is not a leak here
    nb::register_exception_translator([](const std::exception_ptr& error, void*) {
        try {
            std::rethrow_exception(error);
        } catch (const TooLarge& e) {
            PyErr_SetString(PyExc_MemoryError, e.what());
        }
    });
    m.attr("most_kept_memory") = most_kept_memory();
    m.def("free_memory", &free_memory, nb::arg("root") = "", "Bytes that this process could still get, according to the system's files below `root`.");
    m.def("release_memory", &release_memory, "Give back to the system what finished frames left for the next ones; bytes.");
    nb::class_<Frame>(m, "Frame", "What a forward pass keeps for its backward pass.");
    m.def("forward", &forward, nb::arg("camera"), nb::arg("gaussians"), nb::arg("convexes"), nb::arg("frame"), nb::arg("keep"), nb::arg("threads"));
    m.def("backward", &backward_frame, nb::arg("frame"), nb::arg("grad"), nb::arg("camera"), nb::arg("gaussians"), nb::arg("convexes"),
          nb::arg("threads"));
    add_launching(m);
    m.def("kernels", [] { return std::string(kernels().name); }, "The instruction set in use: avx512, avx2 or baseline.");
    m.def("select_kernels", [](const std::string& name) { return select_kernels(name.c_str()); }, nb::arg("name"),
          "Use another instruction set; False where the processor or the build lacks it.");
}
