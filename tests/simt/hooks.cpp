// What GCC's -fsanitize=thread makes kernels call, answered by `races` instead of the sanitizer's own library.
#include "races.h"

// The instruction before the one that a call of ours returns to.
#define SIMT_BY (uintptr_t(__builtin_return_address(0)) - 1)
#define SIMT_HOOK extern "C" __attribute__((noinline))
#define SIMT_ACCESS(name, bytes, writes, atomic) \
    SIMT_HOOK void __tsan_##name(void* at) { simt::races.access(uintptr_t(at), bytes, writes, atomic, SIMT_BY); }
#define SIMT_ACCESSES(bytes)                                  \
    SIMT_ACCESS(read##bytes, bytes, false, false)             \
    SIMT_ACCESS(write##bytes, bytes, true, false)             \
    SIMT_ACCESS(unaligned_read##bytes, bytes, false, false)   \
    SIMT_ACCESS(unaligned_write##bytes, bytes, true, false)   \
    SIMT_ACCESS(volatile_read##bytes, bytes, false, true)     \
    SIMT_ACCESS(volatile_write##bytes, bytes, true, true)     \
    SIMT_ACCESS(unaligned_volatile_read##bytes, bytes, false, true) \
    SIMT_ACCESS(unaligned_volatile_write##bytes, bytes, true, true)
SIMT_ACCESSES(1)
SIMT_ACCESSES(2)
SIMT_ACCESSES(4)
SIMT_ACCESSES(8)
SIMT_ACCESSES(16)

SIMT_HOOK void __tsan_read_range(void* at, unsigned long bytes) {
    simt::races.access(uintptr_t(at), bytes, false, false, SIMT_BY);
}
SIMT_HOOK void __tsan_write_range(void* at, unsigned long bytes) {
    simt::races.access(uintptr_t(at), bytes, true, false, SIMT_BY);
}
SIMT_HOOK void __tsan_init() { simt::watching = true; }  // when the library is loaded
SIMT_HOOK void __tsan_func_entry(void*) {}
SIMT_HOOK void __tsan_func_exit() {}

namespace simt {
void note_atomic(const void* at, size_t bytes, const void* back) { races.access(uintptr_t(at), bytes, true, true, uintptr_t(back) - 1); }
}  // namespace simt
