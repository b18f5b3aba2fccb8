// Threads that take turns on one processor thread, each with its own stack. A switch saves what the calling convention says a function
// must keep, and nothing else: a few nanoseconds, where swapcontext enters the kernel for the signal mask.
#pragma once
#include <cstddef>
#include <cstdint>

#if !defined(SIMT_UCONTEXT) && !defined(__x86_64__) && !defined(__aarch64__)
#define SIMT_UCONTEXT  // any other machine; or by -D, to have the portable way tested
#endif
#if defined(SIMT_UCONTEXT)
#include <ucontext.h>
#endif

namespace simt {

#if defined(SIMT_UCONTEXT)

struct Fiber {
    ucontext_t context;
};

inline void prepare(Fiber& fiber, char* stack, size_t bytes, void (*entry)()) {
    getcontext(&fiber.context);
    fiber.context.uc_stack.ss_sp = stack;
    fiber.context.uc_stack.ss_size = bytes;
    fiber.context.uc_link = nullptr;
    makecontext(&fiber.context, entry, 0);
}

inline void transfer(Fiber& from, Fiber& to) { swapcontext(&from.context, &to.context); }

#else

extern "C" void simt_switch(void** save_stack, void* stack);

#if defined(__x86_64__)
constexpr int kEntry = 6, kFrame = 8;  // in words: where the return address lies; down to an aligned stack
asm(R"(
    .text
    .p2align 4
    .hidden simt_switch
    .globl simt_switch
    .type simt_switch, @function
simt_switch:
    pushq %rbp
    pushq %rbx
    pushq %r12
    pushq %r13
    pushq %r14
    pushq %r15
    movq %rsp, (%rdi)
    movq %rsi, %rsp
    popq %r15
    popq %r14
    popq %r13
    popq %r12
    popq %rbx
    popq %rbp
    ret
    .size simt_switch, .-simt_switch
)");
#else
constexpr int kEntry = 11, kFrame = 20;
asm(R"(
    .text
    .p2align 4
    .hidden simt_switch
    .globl simt_switch
    .type simt_switch, %function
simt_switch:
    sub sp, sp, #160
    stp x19, x20, [sp]
    stp x21, x22, [sp, #16]
    stp x23, x24, [sp, #32]
    stp x25, x26, [sp, #48]
    stp x27, x28, [sp, #64]
    stp x29, x30, [sp, #80]
    stp d8, d9, [sp, #96]
    stp d10, d11, [sp, #112]
    stp d12, d13, [sp, #128]
    stp d14, d15, [sp, #144]
    mov x2, sp
    str x2, [x0]
    mov sp, x1
    ldp x19, x20, [sp]
    ldp x21, x22, [sp, #16]
    ldp x23, x24, [sp, #32]
    ldp x25, x26, [sp, #48]
    ldp x27, x28, [sp, #64]
    ldp x29, x30, [sp, #80]
    ldp d8, d9, [sp, #96]
    ldp d10, d11, [sp, #112]
    ldp d12, d13, [sp, #128]
    ldp d14, d15, [sp, #144]
    add sp, sp, #160
    ret
    .size simt_switch, .-simt_switch
)");
#endif

struct Fiber {
    void* stack = nullptr;  // its pointer, while others run
};

// `entry` starts at the first transfer, and must not return.
inline void prepare(Fiber& fiber, char* stack, size_t bytes, void (*entry)()) {
    uint64_t* top = reinterpret_cast<uint64_t*>(reinterpret_cast<uintptr_t>(stack + bytes) & ~uintptr_t(63)) - kFrame;
    for (int i = 0; i < kFrame; ++i) top[i] = 0;
    top[kEntry] = reinterpret_cast<uintptr_t>(entry);
    fiber.stack = top;
}

inline void transfer(Fiber& from, Fiber& to) { simt_switch(&from.stack, to.stack); }

#endif

}  // namespace simt
