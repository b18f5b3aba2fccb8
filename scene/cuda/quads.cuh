// Four floats at a time: the part of a feature that a lane holds, 16 adjacent bytes.
#pragma once
#include "device.cuh"

namespace e4dgs {

__device__ __forceinline__ float4 load_quad(const float* at) { return __ldg(reinterpret_cast<const float4*>(at)); }
__device__ __forceinline__ void store_quad(float* at, float4 v) { *reinterpret_cast<float4*>(at) = v; }

__device__ __forceinline__ float4 times(float4 a, float4 b) { return make_float4(a.x * b.x, a.y * b.y, a.z * b.z, a.w * b.w); }
__device__ __forceinline__ float4 times(float a, float4 b) { return make_float4(a * b.x, a * b.y, a * b.z, a * b.w); }
__device__ __forceinline__ float4 plus(float4 sum, float a, float4 b) {
    return make_float4(fmaf(a, b.x, sum.x), fmaf(a, b.y, sum.y), fmaf(a, b.z, sum.z), fmaf(a, b.w, sum.w));
}

// Adds to four floats in global memory, each atomically; in one transaction on hardware that supports it (sm_90 and later).
__device__ __forceinline__ void add_quad(float* at, float4 v) {
#if defined(__CUDA_ARCH__) && __CUDA_ARCH__ >= 900
    asm volatile("red.relaxed.gpu.global.add.v4.f32 [%0], {%1, %2, %3, %4};" ::"l"(__cvta_generic_to_global(at)), "f"(v.x), "f"(v.y), "f"(v.z), "f"(v.w));
#else
    atomicAdd(at, v.x), atomicAdd(at + 1, v.y), atomicAdd(at + 2, v.z), atomicAdd(at + 3, v.w);
#endif
}

}  // namespace e4dgs
