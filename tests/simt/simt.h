// What a kernel's source needs from CUDA, for a C++20 compiler of the host.
#pragma once
#include "atomics.h"
#include "collectives.h"
#include "intrinsics.h"
#include "runtime.h"
#include "vectors.h"

#define __host__
#define __device__
#define __constant__
#define __forceinline__ inline __attribute__((always_inline))
#define __noinline__ __attribute__((noinline))
#define __align__(bytes) __attribute__((aligned(bytes)))
// These two are found again in the preprocessed source (compiler.py): which functions are kernels, with how many threads at most.
#define __global__ __attribute__((simt_kernel, noinline, used))
#define __launch_bounds__(threads, ...) __attribute__((simt_bound(threads)))
// One variable a block: blocks run one after another. What marks it is that it is the only kind of thread-local variable in the library:
// launch.cpp finds them all, those of templates too (for which GCC forgets a section's name). `used`, or what no thread writes would be
// taken for zero.
#define __shared__ static __thread __attribute__((used))
// After __shared__, where CUDA takes it, the keyword would not be allowed.
#define alignas(bytes) __attribute__((aligned(bytes)))
