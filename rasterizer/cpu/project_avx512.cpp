#define E4DGS_ISA e4dgs_avx512
#include "simd_avx512.h"
//
#include "project.inl"
