// Pack, a vector of doubles that serves as the scalar type of math/, to process several primitives at once. Its width depends on the
// instruction set.
#pragma once
#include <cstdint>

#if defined(__AVX2__)
#include <immintrin.h>
#endif

#include "constants.h"

namespace E4DGS_ISA {

#if defined(__AVX512F__)
constexpr int kLanes = 8;
#elif defined(__AVX2__)
constexpr int kLanes = 4;
#else
constexpr int kLanes = 2;
#endif

typedef double Doubles __attribute__((vector_size(8 * kLanes)));
typedef int64_t Words __attribute__((vector_size(8 * kLanes)));
static_assert(kLanes <= 8);

struct Truths {  // all bits of a lane are set if the condition holds there
    Words w;
    friend Truths operator&(Truths a, Truths b) { return {a.w & b.w}; }
    friend Truths operator|(Truths a, Truths b) { return {a.w | b.w}; }
};

struct Indices {  // one point index per lane
    int64_t at[kLanes];
};

struct Pack {
    Doubles v;
    Pack() = default;
    Pack(Doubles d) : v(d) {}
    Pack(double d) : v(d - Doubles{}) {}
    Pack(int d) : Pack(double(d)) {}
    friend Pack operator+(Pack a, Pack b) { return a.v + b.v; }
    friend Pack operator-(Pack a, Pack b) { return a.v - b.v; }
    friend Pack operator*(Pack a, Pack b) { return a.v * b.v; }
    friend Pack operator/(Pack a, Pack b) { return a.v / b.v; }
    friend Pack operator-(Pack a) { return -a.v; }
    friend Pack& operator+=(Pack& a, Pack b) { return a = a + b; }
    friend Pack& operator-=(Pack& a, Pack b) { return a = a - b; }
    friend Pack& operator*=(Pack& a, Pack b) { return a = a * b; }
    friend Truths operator<(Pack a, Pack b) { return {a.v < b.v}; }
    friend Truths operator>(Pack a, Pack b) { return {a.v > b.v}; }
    friend Truths operator<=(Pack a, Pack b) { return {a.v <= b.v}; }
    friend Truths operator>=(Pack a, Pack b) { return {a.v >= b.v}; }
    friend Pack choose(Truths t, Pack a, Pack b) { return t.w ? a.v : b.v; }
    friend Pack larger(Pack a, Pack b) { return a.v > b.v ? a.v : b.v; }
    friend Pack smaller(Pack a, Pack b) { return a.v < b.v ? a.v : b.v; }
    friend Pack fabs(Pack a) { return reinterpret_cast<Doubles>(reinterpret_cast<Words>(a.v) & INT64_MAX); }
    friend Pack sqrt(Pack a) {
#if defined(__AVX512F__)
        return Doubles(_mm512_sqrt_pd(__m512d(a.v)));
#elif defined(__AVX2__)
        return Doubles(_mm256_sqrt_pd(__m256d(a.v)));
#else
        Doubles out;
        for (int l = 0; l < kLanes; ++l) out[l] = __builtin_sqrt(a.v[l]);
        return out;
#endif
    }
    // For positive normal numbers, with a relative error below 1e-13. Uses 2 atanh((m - 1) / (m + 1)) for m in [sqrt 1/2, sqrt 2).
    friend Pack log2(Pack a) {
        const Words bits = reinterpret_cast<Words>(a.v), exponent = (bits - 0x3fe6a09e667f3bcdll) >> 52;
        const Doubles m = reinterpret_cast<Doubles>(bits - (exponent << 52)), s = (m - 1.0) / (m + 1.0), z = s * s;
        Doubles p = z * (1.0 / 17) + 1.0 / 15;
        p = p * z + 1.0 / 13;
        p = p * z + 1.0 / 11;
        p = p * z + 1.0 / 9;
        p = p * z + 1.0 / 7;
        p = p * z + 1.0 / 5;
        p = p * z + 1.0 / 3;
        p = p * z + 1.0;
        return __builtin_convertvector(exponent, Doubles) + p * s * (2 * e4dgs::kLog2E);
    }
    friend Pack pick(const Pack* from, const Indices& index) {
        Doubles out;
        for (int l = 0; l < kLanes; ++l) out[l] = reinterpret_cast<const double*>(from)[index.at[l] * kLanes + l];
        return out;
    }
    friend void add_at(Pack* to, const Indices& index, Pack value) {
        for (int l = 0; l < kLanes; ++l) reinterpret_cast<double*>(to)[index.at[l] * kLanes + l] += value.v[l];
    }
};

inline bool none(Truths t) {
    int64_t any = 0;
    for (int l = 0; l < kLanes; ++l) any |= t.w[l];
    return any == 0;
}

// A gradient that is not needed: what is added to it is discarded at no cost.
struct Nothing {
    template <class U> void operator+=(const U&) {}
    template <class U> void operator-=(const U&) {}
};

struct NoCameraGrad {
    Nothing fx, fy, cx, cy, R[9], t[3];
};

}  // namespace E4DGS_ISA

namespace e4dgs {
template <>
struct TruthOf<E4DGS_ISA::Pack> {
    using type = E4DGS_ISA::Truths;
};
template <>
struct IndexOf<E4DGS_ISA::Pack> {
    using type = E4DGS_ISA::Indices;
};
}  // namespace e4dgs
