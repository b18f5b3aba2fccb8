#define E4DGS_ISA e4dgs_avx2
#include "simd_avx2.h"
//
#include "project.inl"
