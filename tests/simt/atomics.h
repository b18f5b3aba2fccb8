// CUDA's atomic functions. Threads take turns, and are never interrupted between two collectives: plain reads and writes do.
#pragma once
#include <cstddef>
#include <type_traits>

namespace simt {
template <class T, class... Among>
concept one_of = (std::is_same_v<T, Among> || ...);
template <class T>  // `unsigned long` is a host's uint64_t, where CUDA has `unsigned long long`
concept atomic_bits = one_of<T, int, unsigned, unsigned long, unsigned long long>;
template <class T>
concept atomic_number = atomic_bits<T> || one_of<T, float, double>;
template <class T>
concept atomic_order = atomic_bits<T> || one_of<T, long, long long>;

#if defined(__SANITIZE_THREAD__)
void note_atomic(const void* at, size_t bytes, const void* back);  // back: where the kernel goes on
#define SIMT_ATOMIC __attribute__((no_sanitize_thread, noinline))
#else
inline void note_atomic(const void*, size_t, const void*) {}
#define SIMT_ATOMIC inline
#endif

template <class T, class F>
SIMT_ATOMIC T replace(T* at, F&& by) {
    note_atomic(at, sizeof(T), __builtin_return_address(0));
    const T old = *at;
    *at = by(old);
    return old;
}
}  // namespace simt

template <simt::atomic_number T>
T atomicAdd(T* at, std::type_identity_t<T> value) {
    return simt::replace(at, [&](T old) { return T(old + value); });
}
template <simt::one_of<int, unsigned> T>
T atomicSub(T* at, std::type_identity_t<T> value) {
    return simt::replace(at, [&](T old) { return T(unsigned(old) - unsigned(value)); });
}
template <simt::atomic_order T>
T atomicMax(T* at, std::type_identity_t<T> value) {
    return simt::replace(at, [&](T old) { return old < value ? value : old; });
}
template <simt::atomic_order T>
T atomicMin(T* at, std::type_identity_t<T> value) {
    return simt::replace(at, [&](T old) { return value < old ? value : old; });
}
template <class T>
    requires(simt::atomic_bits<T> || simt::one_of<T, float>)
T atomicExch(T* at, std::type_identity_t<T> value) {
    return simt::replace(at, [&](T) { return value; });
}
template <simt::atomic_bits T>
T atomicCAS(T* at, std::type_identity_t<T> expected, std::type_identity_t<T> value) {
    return simt::replace(at, [&](T old) { return old == expected ? value : old; });
}
template <simt::atomic_bits T>
T atomicOr(T* at, std::type_identity_t<T> value) {
    return simt::replace(at, [&](T old) { return T(old | value); });
}
template <simt::atomic_bits T>
T atomicAnd(T* at, std::type_identity_t<T> value) {
    return simt::replace(at, [&](T old) { return T(old & value); });
}
template <simt::atomic_bits T>
T atomicXor(T* at, std::type_identity_t<T> value) {
    return simt::replace(at, [&](T old) { return T(old ^ value); });
}

inline void __threadfence() {}
inline void __threadfence_block() {}
inline void __threadfence_system() {}
inline void __nanosleep(unsigned) {}
