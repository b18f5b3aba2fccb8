// CUDA's functions of one thread: bits, casts, rounding, cached reads, min and max. Approximate ones are exact to a rounding here.
#pragma once
#include <cfloat>
#include <climits>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <type_traits>

#include "runtime.h"

inline int __popc(unsigned bits) { return __builtin_popcount(bits); }
inline int __popcll(unsigned long long bits) { return __builtin_popcountll(bits); }
inline int __ffs(int bits) { return __builtin_ffs(bits); }
inline int __ffsll(long long bits) { return __builtin_ffsll(bits); }
inline int __clz(int bits) { return bits ? __builtin_clz(unsigned(bits)) : 32; }
inline int __clzll(long long bits) { return bits ? __builtin_clzll((unsigned long long)(bits)) : 64; }
inline unsigned __brev(unsigned bits) {
    unsigned reversed = 0;
    for (int i = 0; i < 32; ++i) reversed |= (bits >> i & 1) << (31 - i);
    return reversed;
}
inline unsigned long long __brevll(unsigned long long bits) {
    return (unsigned long long)(__brev(unsigned(bits))) << 32 | __brev(unsigned(bits >> 32));
}
inline int __mulhi(int a, int b) { return int((long long)(a) * b >> 32); }
inline unsigned __umulhi(unsigned a, unsigned b) { return unsigned((unsigned long long)(a) * b >> 32); }
inline unsigned long long __umul64hi(unsigned long long a, unsigned long long b) {
    return (unsigned long long)((unsigned __int128)(a) * b >> 64);
}

inline int __float_as_int(float x) { return __builtin_bit_cast(int, x); }
inline unsigned __float_as_uint(float x) { return __builtin_bit_cast(unsigned, x); }
inline float __int_as_float(int bits) { return __builtin_bit_cast(float, bits); }
inline float __uint_as_float(unsigned bits) { return __builtin_bit_cast(float, bits); }
inline long long __double_as_longlong(double x) { return __builtin_bit_cast(long long, x); }
inline double __longlong_as_double(long long bits) { return __builtin_bit_cast(double, bits); }

// Conversions to int as on the device: what lies outside is clamped, NaN is 0.
namespace simt {
inline int to_int(double x) { return x != x ? 0 : x <= INT_MIN ? INT_MIN : x >= INT_MAX ? INT_MAX : int(x); }
}  // namespace simt
inline int __float2int_rn(float x) { return simt::to_int(nearbyintf(x)); }
inline int __float2int_rd(float x) { return simt::to_int(floorf(x)); }
inline int __float2int_ru(float x) { return simt::to_int(ceilf(x)); }
inline int __float2int_rz(float x) { return simt::to_int(x); }
inline int __double2int_rn(double x) { return simt::to_int(nearbyint(x)); }
inline int __double2int_rd(double x) { return simt::to_int(floor(x)); }
inline int __double2int_ru(double x) { return simt::to_int(ceil(x)); }
inline int __double2int_rz(double x) { return simt::to_int(x); }
inline float __int2float_rn(int x) { return float(x); }
inline float __uint2float_rn(unsigned x) { return float(x); }
inline float __double2float_rn(double x) { return float(x); }

inline float __fmaf_rn(float a, float b, float c) { return fmaf(a, b, c); }
inline double __fma_rn(double a, double b, double c) { return fma(a, b, c); }
inline float __fadd_rn(float a, float b) { return a + b; }
inline float __fsub_rn(float a, float b) { return a - b; }
inline float __fmul_rn(float a, float b) { return a * b; }
inline float __fdiv_rn(float a, float b) { return a / b; }
inline double __dadd_rn(double a, double b) { return a + b; }
inline double __dsub_rn(double a, double b) { return a - b; }
inline double __dmul_rn(double a, double b) { return a * b; }
inline float __fdividef(float a, float b) { return a / b; }
inline float __frcp_rn(float x) { return 1.0f / x; }
inline float __fsqrt_rn(float x) { return sqrtf(x); }
inline float __frsqrt_rn(float x) { return 1.0f / sqrtf(x); }
inline float __saturatef(float x) { return x > 0.0f ? x < 1.0f ? x : 1.0f : 0.0f; }
// Macros, since the host's math.h has these names for itself, or may some day.
#define __expf expf
#define __exp10f exp10f
#define __logf logf
#define __log2f log2f
#define __log10f log10f
#define __powf powf
#define __sinf sinf
#define __cosf cosf
#define __tanf tanf
#define rsqrtf(x) __frsqrt_rn(x)
#define rsqrt(x) (1.0 / sqrt(x))

template <class T> T __ldg(const T* at) { return *at; }
template <class T> T __ldca(const T* at) { return *at; }
template <class T> T __ldcg(const T* at) { return *at; }
template <class T> T __ldcs(const T* at) { return *at; }
template <class T> T __ldlu(const T* at) { return *at; }
template <class T> void __stwb(T* at, std::type_identity_t<T> value) { *at = value; }
template <class T> void __stcg(T* at, std::type_identity_t<T> value) { *at = value; }
template <class T> void __stcs(T* at, std::type_identity_t<T> value) { *at = value; }
template <class T> void __stwt(T* at, std::type_identity_t<T> value) { *at = value; }

// The overloads that CUDA has, so that a call which is ambiguous there is so here.
#define SIMT_MIN_MAX(A, B, T)                                                 \
    constexpr T min(A a, B b) { return (T)(b) < (T)(a) ? (T)(b) : (T)(a); }   \
    constexpr T max(A a, B b) { return (T)(a) < (T)(b) ? (T)(b) : (T)(a); }
#define SIMT_MIN_MAX_OF(T)                           \
    SIMT_MIN_MAX(T, T, T)                            \
    SIMT_MIN_MAX(unsigned T, unsigned T, unsigned T) \
    SIMT_MIN_MAX(T, unsigned T, unsigned T)          \
    SIMT_MIN_MAX(unsigned T, T, unsigned T)
SIMT_MIN_MAX_OF(int)
SIMT_MIN_MAX_OF(long)
SIMT_MIN_MAX_OF(long long)
#undef SIMT_MIN_MAX_OF
#undef SIMT_MIN_MAX
// Of a number and NaN, the number.
inline float min(float a, float b) { return fminf(a, b); }
inline float max(float a, float b) { return fmaxf(a, b); }
inline double min(double a, double b) { return fmin(a, b); }
inline double max(double a, double b) { return fmax(a, b); }
inline double min(float a, double b) { return fmin(a, b); }
inline double max(float a, double b) { return fmax(a, b); }
inline double min(double a, float b) { return fmin(a, b); }
inline double max(double a, float b) { return fmax(a, b); }

#undef assert
#define assert(condition) ((condition) ? void() : simt::fail("breaks assert(" #condition ")", simt::Place::current()))
inline void __trap(simt::Place place = simt::Place::current()) { simt::fail("traps", place); }
