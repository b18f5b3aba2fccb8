// CUDA's vector types, with its alignments: what reads 16 bytes at once from an address that is not a multiple of 16 fails here too.
#pragma once
#include <cstddef>

namespace simt {
constexpr size_t vector_alignment(size_t bytes) { return bytes < 16 ? bytes : 16; }
}  // namespace simt

#define SIMT_VECTOR_TYPES(name, T)                                                        \
    struct name##1 {                                                                      \
        T x;                                                                              \
    };                                                                                    \
    struct alignas(simt::vector_alignment(2 * sizeof(T))) name##2 {                       \
        T x, y;                                                                           \
    };                                                                                    \
    struct name##3 {                                                                      \
        T x, y, z;                                                                        \
    };                                                                                    \
    struct alignas(simt::vector_alignment(4 * sizeof(T))) name##4 {                       \
        T x, y, z, w;                                                                     \
    };                                                                                    \
    constexpr name##1 make_##name##1(T x) { return {x}; }                                 \
    constexpr name##2 make_##name##2(T x, T y) { return {x, y}; }                         \
    constexpr name##3 make_##name##3(T x, T y, T z) { return {x, y, z}; }                 \
    constexpr name##4 make_##name##4(T x, T y, T z, T w) { return {x, y, z, w}; }

SIMT_VECTOR_TYPES(char, signed char)
SIMT_VECTOR_TYPES(uchar, unsigned char)
SIMT_VECTOR_TYPES(short, short)
SIMT_VECTOR_TYPES(ushort, unsigned short)
SIMT_VECTOR_TYPES(int, int)
SIMT_VECTOR_TYPES(uint, unsigned)
SIMT_VECTOR_TYPES(longlong, long long)
SIMT_VECTOR_TYPES(ulonglong, unsigned long long)
SIMT_VECTOR_TYPES(float, float)
SIMT_VECTOR_TYPES(double, double)
#undef SIMT_VECTOR_TYPES

struct dim3 {
    unsigned x = 1, y = 1, z = 1;
};
