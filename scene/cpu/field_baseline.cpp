#define E4DGS_ISA e4dgs_scene_baseline
#include "field.inl"
