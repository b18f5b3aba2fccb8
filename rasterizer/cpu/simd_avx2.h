// Vectors of 8 floats on AVX2 with FMA; see simd_avx512.h for what each name means.
#pragma once
#include <immintrin.h>

#include <cstdint>

namespace E4DGS_ISA {

constexpr int kWidth = 8;
constexpr bool kScaleSaturates = false;
struct Mask { __m256 m; };
struct Int { __m256i v; };
struct Float { __m256 v; };

inline Float set1(float x) { return {_mm256_set1_ps(x)}; }
inline Int set1(int32_t x) { return {_mm256_set1_epi32(x)}; }
inline Float zero() { return {_mm256_setzero_ps()}; }
inline Float load(const float* p) { return {_mm256_load_ps(p)}; }
inline Int load(const int32_t* p) { return {_mm256_load_si256(reinterpret_cast<const __m256i*>(p))}; }
inline void store(float* p, Float a) { _mm256_store_ps(p, a.v); }
inline void store(int32_t* p, Int a) { _mm256_store_si256(reinterpret_cast<__m256i*>(p), a.v); }
inline Float operator+(Float a, Float b) { return {_mm256_add_ps(a.v, b.v)}; }
inline Float operator-(Float a, Float b) { return {_mm256_sub_ps(a.v, b.v)}; }
inline Float operator*(Float a, Float b) { return {_mm256_mul_ps(a.v, b.v)}; }
inline Float fma(Float a, Float b, Float c) { return {_mm256_fmadd_ps(a.v, b.v, c.v)}; }
inline Float fnma(Float a, Float b, Float c) { return {_mm256_fnmadd_ps(a.v, b.v, c.v)}; }
inline Float min(Float a, Float b) { return {_mm256_min_ps(a.v, b.v)}; }
inline Float max(Float a, Float b) { return {_mm256_max_ps(a.v, b.v)}; }
inline Mask operator>=(Float a, Float b) { return {_mm256_cmp_ps(a.v, b.v, _CMP_GE_OQ)}; }
inline Mask operator<(Float a, Float b) { return {_mm256_cmp_ps(a.v, b.v, _CMP_LT_OQ)}; }
inline Mask operator>=(Int a, Int b) {
    const __m256i less = _mm256_cmpgt_epi32(b.v, a.v);
    return {_mm256_castsi256_ps(_mm256_xor_si256(less, _mm256_set1_epi32(-1)))};
}
inline Mask operator&(Mask a, Mask b) { return {_mm256_and_ps(a.m, b.m)}; }
inline Float select(Mask m, Float a, Float b) { return {_mm256_blendv_ps(b.v, a.v, m.m)}; }
inline Int select(Mask m, Int a, Int b) {
    return {_mm256_castps_si256(_mm256_blendv_ps(_mm256_castsi256_ps(b.v), _mm256_castsi256_ps(a.v), m.m))};
}
inline Float keep(Mask m, Float a) { return {_mm256_and_ps(m.m, a.v)}; }
inline uint32_t bits(Mask m) { return uint32_t(_mm256_movemask_ps(m.m)); }

inline Float reciprocal(Float a) { return {_mm256_div_ps(_mm256_set1_ps(1.0f), a.v)}; }
inline Float nearest(Float a) { return {_mm256_round_ps(a.v, _MM_FROUND_TO_NEAREST_INT | _MM_FROUND_NO_EXC)}; }
inline Float scale(Float p, Float n) {
    return {_mm256_castsi256_ps(_mm256_add_epi32(_mm256_castps_si256(p.v), _mm256_slli_epi32(_mm256_cvtps_epi32(n.v), 23)))};
}
inline void split(Float a, Float& exponent, Float& mantissa) {
    const __m256i b = _mm256_castps_si256(a.v);
    exponent.v = _mm256_cvtepi32_ps(_mm256_sub_epi32(_mm256_srli_epi32(b, 23), _mm256_set1_epi32(127)));
    mantissa.v = _mm256_castsi256_ps(
        _mm256_or_si256(_mm256_and_si256(b, _mm256_set1_epi32(0x007fffff)), _mm256_set1_epi32(0x3f800000)));
}

template <int N>
inline void sum_lanes(const Float* v, float* out) {
    const auto in = [v](int k) { return k < N ? v[k].v : _mm256_setzero_ps(); };
    for (int k = 0; k < N; k += 8) {
        const __m256 low = _mm256_hadd_ps(_mm256_hadd_ps(in(k), in(k + 1)), _mm256_hadd_ps(in(k + 2), in(k + 3)));
        const __m256 high = _mm256_hadd_ps(_mm256_hadd_ps(in(k + 4), in(k + 5)), _mm256_hadd_ps(in(k + 6), in(k + 7)));
        _mm256_storeu_ps(out + k, _mm256_add_ps(_mm256_permute2f128_ps(low, high, 0x20), _mm256_permute2f128_ps(low, high, 0x31)));
    }
}

inline void lists_of_bits(const uint16_t* masks, uint64_t (*lists)[2]) {
    const auto part = [masks](int p) { return _mm256_load_si256(reinterpret_cast<const __m256i*>(masks + 16 * p)); };
    for (int b = 0; b < 16; ++b) {
        const __m128i up = _mm_cvtsi32_si128(15 - b);
        for (int w = 0; w < 2; ++w) {
            uint64_t list = 0;
            for (int half = 0; half < 2; ++half) {
                const __m256i low = _mm256_srai_epi16(_mm256_sll_epi16(part(4 * w + 2 * half), up), 15);
                const __m256i high = _mm256_srai_epi16(_mm256_sll_epi16(part(4 * w + 2 * half + 1), up), 15);
                const __m256i bytes = _mm256_permute4x64_epi64(_mm256_packs_epi16(low, high), 0xd8);
                list |= uint64_t(uint32_t(_mm256_movemask_epi8(bytes))) << (32 * half);
            }
            lists[b][w] = list;
        }
    }
}

}  // namespace E4DGS_ISA
