// Vectors of 16 floats on AVX-512. The three simd_*.h headers define the same names, which blend.inl uses.
#pragma once
#include <immintrin.h>

#include <cstdint>

namespace E4DGS_ISA {

constexpr int kWidth = 16;
constexpr bool kScaleSaturates = true;  // scale() gives 0 for any n below the range
struct Mask { __mmask16 m; };
struct Int { __m512i v; };
struct Float { __m512 v; };

inline Float set1(float x) { return {_mm512_set1_ps(x)}; }
inline Int set1(int32_t x) { return {_mm512_set1_epi32(x)}; }
inline Float zero() { return {_mm512_setzero_ps()}; }
inline Float load(const float* p) { return {_mm512_load_ps(p)}; }
inline Int load(const int32_t* p) { return {_mm512_load_si512(p)}; }
inline void store(float* p, Float a) { _mm512_store_ps(p, a.v); }
inline void store(int32_t* p, Int a) { _mm512_store_si512(p, a.v); }
inline Float operator+(Float a, Float b) { return {_mm512_add_ps(a.v, b.v)}; }
inline Float operator-(Float a, Float b) { return {_mm512_sub_ps(a.v, b.v)}; }
inline Float operator*(Float a, Float b) { return {_mm512_mul_ps(a.v, b.v)}; }
inline Float fma(Float a, Float b, Float c) { return {_mm512_fmadd_ps(a.v, b.v, c.v)}; }      // a b + c
inline Float fnma(Float a, Float b, Float c) { return {_mm512_fnmadd_ps(a.v, b.v, c.v)}; }    // c - a b
inline Float min(Float a, Float b) { return {_mm512_min_ps(a.v, b.v)}; }
inline Float max(Float a, Float b) { return {_mm512_max_ps(a.v, b.v)}; }
inline Mask operator>=(Float a, Float b) { return {_mm512_cmp_ps_mask(a.v, b.v, _CMP_GE_OQ)}; }
inline Mask operator<(Float a, Float b) { return {_mm512_cmp_ps_mask(a.v, b.v, _CMP_LT_OQ)}; }
inline Mask operator>=(Int a, Int b) { return {_mm512_cmp_epi32_mask(a.v, b.v, _MM_CMPINT_NLT)}; }
inline Mask operator&(Mask a, Mask b) { return {__mmask16(a.m & b.m)}; }
inline Float select(Mask m, Float a, Float b) { return {_mm512_mask_mov_ps(b.v, m.m, a.v)}; }
inline Int select(Mask m, Int a, Int b) { return {_mm512_mask_mov_epi32(b.v, m.m, a.v)}; }
inline Float keep(Mask m, Float a) { return {_mm512_maskz_mov_ps(m.m, a.v)}; }  // 0 elsewhere
inline uint32_t bits(Mask m) { return m.m; }

// 1 / a, with an error below 1e-7; exact at 1. a in [1e-30, 1e30].
inline Float reciprocal(Float a) {
    const __m512 r = _mm512_rcp14_ps(a.v);
    return {_mm512_fmadd_ps(r, _mm512_fnmadd_ps(a.v, r, _mm512_set1_ps(1.0f)), r)};
}

// scale(p, n) = p 2^n for an integer n.
inline Float nearest(Float a) { return {_mm512_roundscale_ps(a.v, _MM_FROUND_TO_NEAREST_INT | _MM_FROUND_NO_EXC)}; }
inline Float scale(Float p, Float n) { return {_mm512_scalef_ps(p.v, n.v)}; }

// a = 2^exponent * mantissa, mantissa in [1, 2); a positive and normal.
inline void split(Float a, Float& exponent, Float& mantissa) {
    mantissa.v = _mm512_getmant_ps(a.v, _MM_MANT_NORM_1_2, _MM_MANT_SIGN_src);
    exponent.v = _mm512_getexp_ps(a.v);
}

// out[k] = sum of the lanes of v[k] for k < N <= 16; out has room for 16. A tree that halves and pairs the vectors.
template <int N>
inline void sum_lanes(const Float* v, float* out) {
    static_assert(N <= 16);
    const auto in = [v](int k) { return k < N ? v[k].v : _mm512_setzero_ps(); };
    const auto halves = [](__m512 a, __m512 b) {
        return _mm512_add_ps(_mm512_shuffle_f32x4(a, b, 0x44), _mm512_shuffle_f32x4(a, b, 0xee));
    };
    const auto quarters = [](__m512 a, __m512 b) {
        return _mm512_add_ps(_mm512_shuffle_f32x4(a, b, 0x88), _mm512_shuffle_f32x4(a, b, 0xdd));
    };
    const auto pairs = [](__m512 a, __m512 b) {
        return _mm512_add_ps(_mm512_shuffle_ps(a, b, 0x44), _mm512_shuffle_ps(a, b, 0xee));
    };
    const auto single = [](__m512 a, __m512 b) {
        return _mm512_add_ps(_mm512_shuffle_ps(a, b, 0x88), _mm512_shuffle_ps(a, b, 0xdd));
    };
    __m512 column[4];
    for (int c = 0; c < 4; ++c) column[c] = quarters(halves(in(c), in(c + 4)), halves(in(c + 8), in(c + 12)));
    _mm512_storeu_ps(out, single(pairs(column[0], column[1]), pairs(column[2], column[3])));
}

// lists[b]: which of the 128 masks have bit b set.
inline void lists_of_bits(const uint16_t* masks, uint64_t (*lists)[2]) {
    __m512i part[4];
    for (int p = 0; p < 4; ++p) part[p] = _mm512_load_si512(masks + 32 * p);
    for (int b = 0; b < 16; ++b) {
        const __m512i bit = _mm512_set1_epi16(short(1 << b));
        for (int w = 0; w < 2; ++w)
            lists[b][w] = uint64_t(_mm512_test_epi16_mask(part[2 * w], bit)) | uint64_t(_mm512_test_epi16_mask(part[2 * w + 1], bit)) << 32;
    }
}

}  // namespace E4DGS_ISA
