#define E4DGS_ISA e4dgs_scene_avx512
#include "field.inl"
