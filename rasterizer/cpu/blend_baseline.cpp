#define E4DGS_ISA e4dgs_baseline
#define E4DGS_ISA_NAME "baseline"
#include "simd_portable.h"
//
#include "blend.inl"
