// Blends one tile, forward and backward, for one instruction set: a blend_*.cpp defines E4DGS_ISA, includes its simd_*.h and then this
// file. Skipping and stopping work on blocks of 4 x 4 pixels.
#include "blend.h"

namespace E4DGS_ISA {
namespace {

using namespace e4dgs;

#include "elementary.inl"
#include "items.inl"
#include "gaussian_alpha.inl"
#include "convex_blocks.inl"
#include "convex_alpha.inl"
#include "forward.inl"
#include "backward_layers.inl"
#include "backward_convex.inl"
#include "backward.inl"
#include "attribution.inl"

}  // namespace

extern const Kernels kKernels;
const Kernels kKernels = {E4DGS_ISA_NAME, &forward_tile, &backward_tile, &attribute_tile};

}  // namespace E4DGS_ISA
