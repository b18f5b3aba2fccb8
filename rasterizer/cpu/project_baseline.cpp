#define E4DGS_ISA e4dgs_baseline
#include "simd_portable.h"
//
#include "project.inl"
