// CUDA's collectives of a warp and of a block. What CUDA leaves undefined gives values of all ones: NaN for floating types.
#pragma once
#include <cstring>
#include <type_traits>

#include "runtime.h"

namespace simt {

template <class T>
uint64_t to_bits(T value) {
    static_assert(std::is_arithmetic_v<T> && (sizeof(T) == 4 || sizeof(T) == 8), "lanes exchange numbers of 32 or 64 bits");
    uint64_t bits = 0;
    std::memcpy(&bits, &value, sizeof(T));
    return bits;
}

template <class T>
T from_bits(uint64_t bits) {
    T value;
    std::memcpy(&value, &bits, sizeof(T));
    return value;
}

template <class T>
T exchange(Meeting meeting, unsigned mask, T value, unsigned source, int width, const Place& place) {
    if (width != warpSize) fail("asks for a width other than 32, which the emulator does not know", place);
    const uint64_t* met = meet(meeting, mask, to_bits(value), place);
    return from_bits<T>(mask >> source & 1 ? met[source] : ~uint64_t(0));
}

inline unsigned lane() { return threadIdx.x % warpSize; }

}  // namespace simt

template <class T>
T __shfl_sync(unsigned mask, T value, int source, int width = 32, simt::Place place = simt::Place::current()) {
    return simt::exchange(simt::Meeting::shfl, mask, value, unsigned(source) % 32, width, place);
}
template <class T>
T __shfl_up_sync(unsigned mask, T value, unsigned delta, int width = 32, simt::Place place = simt::Place::current()) {
    const unsigned lane = simt::lane();
    return simt::exchange(simt::Meeting::shfl_up, mask, value, delta > lane ? lane : lane - delta, width, place);
}
template <class T>
T __shfl_down_sync(unsigned mask, T value, unsigned delta, int width = 32, simt::Place place = simt::Place::current()) {
    const unsigned lane = simt::lane();
    return simt::exchange(simt::Meeting::shfl_down, mask, value, delta > 31 - lane ? lane : lane + delta, width, place);
}
template <class T>
T __shfl_xor_sync(unsigned mask, T value, int bits, int width = 32, simt::Place place = simt::Place::current()) {
    const unsigned source = simt::lane() ^ unsigned(bits);
    return simt::exchange(simt::Meeting::shfl_xor, mask, value, source > 31 ? simt::lane() : source, width, place);
}

inline unsigned __ballot_sync(unsigned mask, int predicate, simt::Place place = simt::Place::current()) {
    return unsigned(simt::meet(simt::Meeting::ballot, mask, predicate != 0, place)[simt::lane()]);
}
inline int __any_sync(unsigned mask, int predicate, simt::Place place = simt::Place::current()) {
    return simt::meet(simt::Meeting::any, mask, predicate != 0, place)[simt::lane()] != 0;
}
inline int __all_sync(unsigned mask, int predicate, simt::Place place = simt::Place::current()) {
    return simt::meet(simt::Meeting::all, mask, predicate != 0, place)[simt::lane()] == mask;
}
template <class T>
unsigned __match_any_sync(unsigned mask, T value, simt::Place place = simt::Place::current()) {
    const uint64_t bits = simt::to_bits(value), *met = simt::meet(simt::Meeting::match_any, mask, bits, place);
    unsigned same = 0;
    for (unsigned i = 0; i < 32; ++i) same |= unsigned(met[i] == bits) << i;
    return same & mask;
}
inline void __syncwarp(unsigned mask = ~0u, simt::Place place = simt::Place::current()) {
    simt::meet(simt::Meeting::syncwarp, mask, 0, place);
}

inline void __syncthreads(simt::Place place = simt::Place::current()) { simt::gather(simt::Meeting::syncthreads, false, place); }
inline int __syncthreads_or(int predicate, simt::Place place = simt::Place::current()) {
    return simt::gather(simt::Meeting::syncthreads_or, predicate != 0, place).those != 0;
}
inline int __syncthreads_and(int predicate, simt::Place place = simt::Place::current()) {
    const simt::Count count = simt::gather(simt::Meeting::syncthreads_and, predicate != 0, place);
    return count.those == count.all;
}
inline int __syncthreads_count(int predicate, simt::Place place = simt::Place::current()) {
    return simt::gather(simt::Meeting::syncthreads_count, predicate != 0, place).those;
}

// Which lanes happen to run together is no mask to synchronise with: kernels compute their masks, or pass them on.
unsigned __activemask() = delete;
