#define E4DGS_ISA e4dgs_avx2
#define E4DGS_ISA_NAME "avx2"
#include "simd_avx2.h"
//
#include "blend.inl"
