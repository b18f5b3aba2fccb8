// Chooses the instruction set of the field's kernels: the best that this processor supports.
#include <cstdlib>
#include <string_view>

#include "field.h"

#if defined(E4DGS_X86)
namespace e4dgs_scene_avx2 { extern const e4dgs::FieldKernels kFieldKernels; }
namespace e4dgs_scene_avx512 { extern const e4dgs::FieldKernels kFieldKernels; }
#endif
namespace e4dgs_scene_baseline { extern const e4dgs::FieldKernels kFieldKernels; }

namespace e4dgs {
namespace {

const FieldKernels* chosen = nullptr;

const FieldKernels* find(std::string_view name) {
#if defined(E4DGS_X86)
    __builtin_cpu_init();
    const bool avx2 = __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma") && __builtin_cpu_supports("bmi2");
    const bool avx512 = avx2 && __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512bw") && __builtin_cpu_supports("avx512cd") &&
                        __builtin_cpu_supports("avx512dq") && __builtin_cpu_supports("avx512vl");
    if (avx512 && (name.empty() || name == "avx512")) return &e4dgs_scene_avx512::kFieldKernels;
    if (avx2 && (name.empty() || name == "avx2")) return &e4dgs_scene_avx2::kFieldKernels;
#endif
    return name.empty() || name == "baseline" ? &e4dgs_scene_baseline::kFieldKernels : nullptr;
}

}  // namespace

const FieldKernels& field_kernels() {
    if (!chosen) chosen = find("");
    return *chosen;
}

bool select_field_kernels(const char* name) {
    const FieldKernels* found = find(name);
    if (found) chosen = found;
    return found != nullptr;
}

}  // namespace e4dgs
