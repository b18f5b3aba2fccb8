#define E4DGS_ISA e4dgs_scene_avx2
#include "field.inl"
