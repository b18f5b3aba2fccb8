// One binary for every x86-64: the compiler emits a leaf function once for each instruction set, and the loader picks one.
// Used only on leaf functions: code outlined for an OpenMP region would be compiled for the baseline only.
#pragma once

#if defined(__x86_64__) && defined(__gnu_linux__) && defined(__GNUC__) && !defined(__clang__) && !defined(E4DGS_NO_CLONES)
#define E4DGS_CLONES __attribute__((target_clones("arch=x86-64-v4", "arch=x86-64-v3", "default")))
#else
#define E4DGS_CLONES
#endif

// For what such a function calls: a function that is not inlined there is compiled for the baseline only.
#define E4DGS_INLINE [[gnu::always_inline]] inline
