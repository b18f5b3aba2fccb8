// Vectors of 4 floats in the compiler's vector extension (SSE2, NEON, ...); see simd_avx512.h for what each name means.
#pragma once
#include <cstdint>
#include <cstring>

namespace E4DGS_ISA {

constexpr int kWidth = 4;
constexpr bool kScaleSaturates = false;
typedef float float4 __attribute__((vector_size(16)));
typedef int32_t int4 __attribute__((vector_size(16)));
struct Mask { int4 m; };
struct Int { int4 v; };
struct Float { float4 v; };

inline Float set1(float x) { return {float4{x, x, x, x}}; }
inline Int set1(int32_t x) { return {int4{x, x, x, x}}; }
inline Float zero() { return set1(0.0f); }
inline Float load(const float* p) { return {*reinterpret_cast<const float4*>(p)}; }
inline Int load(const int32_t* p) { return {*reinterpret_cast<const int4*>(p)}; }
inline void store(float* p, Float a) { *reinterpret_cast<float4*>(p) = a.v; }
inline void store(int32_t* p, Int a) { *reinterpret_cast<int4*>(p) = a.v; }
inline Float operator+(Float a, Float b) { return {a.v + b.v}; }
inline Float operator-(Float a, Float b) { return {a.v - b.v}; }
inline Float operator*(Float a, Float b) { return {a.v * b.v}; }
inline Float fma(Float a, Float b, Float c) { return {a.v * b.v + c.v}; }
inline Float fnma(Float a, Float b, Float c) { return {c.v - a.v * b.v}; }
inline Float min(Float a, Float b) { return {a.v < b.v ? a.v : b.v}; }
inline Float max(Float a, Float b) { return {a.v > b.v ? a.v : b.v}; }
inline Mask operator>=(Float a, Float b) { return {a.v >= b.v}; }
inline Mask operator<(Float a, Float b) { return {a.v < b.v}; }
inline Mask operator>=(Int a, Int b) { return {a.v >= b.v}; }
inline Mask operator&(Mask a, Mask b) { return {a.m & b.m}; }
inline Float select(Mask m, Float a, Float b) { return {m.m ? a.v : b.v}; }
inline Int select(Mask m, Int a, Int b) { return {m.m ? a.v : b.v}; }
inline Float keep(Mask m, Float a) { return {reinterpret_cast<float4>(reinterpret_cast<int4>(a.v) & m.m)}; }
inline uint32_t bits(Mask m) { return (m.m[0] & 1) | (m.m[1] & 2) | (m.m[2] & 4) | (m.m[3] & 8); }
inline Float reciprocal(Float a) { return {1.0f / a.v}; }

// Adding 1.5 * 2^23 leaves the nearest integer in the low bits. Requires |a| < 2^22.
inline Float nearest(Float a) {
    const float4 magic = set1(12582912.0f).v;
    return {(a.v + magic) - magic};
}
inline Float scale(Float p, Float n) {
    return {reinterpret_cast<float4>(reinterpret_cast<int4>(p.v) + (__builtin_convertvector(n.v, int4) << 23))};
}
inline void split(Float a, Float& exponent, Float& mantissa) {
    const int4 b = reinterpret_cast<int4>(a.v);
    exponent.v = __builtin_convertvector((b >> 23) - 127, float4);
    mantissa.v = reinterpret_cast<float4>((b & 0x007fffff) | 0x3f800000);
}

template <int N>
inline void sum_lanes(const Float* v, float* out) {
    for (int k = 0; k < N; ++k) out[k] = (v[k].v[0] + v[k].v[2]) + (v[k].v[1] + v[k].v[3]);
}

inline void lists_of_bits(const uint16_t* masks, uint64_t (*lists)[2]) {
    std::memset(lists, 0, 16 * sizeof(*lists));
    for (int j = 0; j < 128; ++j)
        for (uint32_t m = masks[j]; m; m &= m - 1) lists[__builtin_ctz(m)][j / 64] |= uint64_t(1) << (j % 64);
}

}  // namespace E4DGS_ISA
