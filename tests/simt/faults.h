// Bad accesses, traps and endless loops of a kernel as errors of its launch, instead of the end of the process.
#pragma once
#include <signal.h>
#include <time.h>
#include <ucontext.h>
#include <unistd.h>

#include <cstdio>
#include <iterator>

#include "block.h"

namespace simt {

// While one exists, what happens on a fiber (the stack pointer is in [low, high)) ends the launch. Elsewhere, as for other threads of
// the process, the handlers that were there before get it. `seconds` of processor time are what the launch may take.
class Faults {
public:
    Faults(const char* low, const char* high, double seconds) {
        low_ = low, high_ = high;
        const stack_t stack = {.ss_sp = stack_, .ss_flags = 0, .ss_size = sizeof stack_};  // a fiber may have used up its own
        sigaltstack(&stack, &stack_before_);
        struct sigaction action = {};
        action.sa_sigaction = handle;
        action.sa_flags = SA_SIGINFO | SA_ONSTACK | SA_NODEFER;
        for (size_t i = 0; i < std::size(kSignals); ++i) sigaction(kSignals[i], &action, &before_[i]);
        sigevent event = {};
        event.sigev_notify = SIGEV_THREAD_ID, event.sigev_signo = SIGXCPU;
        event._sigev_un._tid = gettid();
        has_timer_ = timer_create(CLOCK_THREAD_CPUTIME_ID, &event, &timer_) == 0;
        const time_t whole = time_t(seconds);
        const itimerspec at = {.it_interval = {0, 10'000'000}, .it_value = {whole, long((seconds - double(whole)) * 1e9) + 1}};
        if (has_timer_) timer_settime(timer_, 0, &at, nullptr);
    }
    Faults(const Faults&) = delete;
    ~Faults() {
        if (has_timer_) timer_delete(timer_);
        for (size_t i = 0; i < std::size(kSignals); ++i) sigaction(kSignals[i], &before_[i], nullptr);
        sigaltstack(&stack_before_, nullptr);
    }

private:
    static constexpr int kSignals[] = {SIGXCPU, SIGSEGV, SIGBUS, SIGFPE, SIGILL, SIGTRAP};

    static void handle(int signal, siginfo_t* info, void* context) {
        const mcontext_t& machine = static_cast<ucontext_t*>(context)->uc_mcontext;
#if defined(__x86_64__)
        const uintptr_t at = machine.gregs[REG_RIP], stack = machine.gregs[REG_RSP];
#elif defined(__aarch64__)
        const uintptr_t at = machine.pc, stack = machine.sp;
#else
        const uintptr_t at = 0, stack = 0;  // not known here: nothing is caught
#endif
        const bool in_fiber = stack >= uintptr_t(low_) && stack < uintptr_t(high_);
        const bool in_library = at >= uintptr_t(&__ehdr_start) && at < uintptr_t(&etext);
        if (signal == SIGXCPU) {  // of the timer, which comes again: nobody may be left inside malloc or printf
            if (in_fiber && in_library && !block.busy) end("has run for too long", at);
            return;
        }
        if (!in_fiber) {
            for (size_t i = 0; i < std::size(kSignals); ++i)
                if (kSignals[i] == signal) sigaction(signal, &before_[i], nullptr);
            return;  // and it happens again
        }
        char what[80] = "traps, or breaks a rule that the compiler checks";
        if (signal == SIGFPE) std::snprintf(what, sizeof what, "divides an integer by zero");
        if (signal == SIGSEGV || signal == SIGBUS) {
            const bool odd = info->si_code == SI_KERNEL || (signal == SIGBUS && info->si_code == BUS_ADRALN);
            const char* const why = odd ? "a misaligned address, or none at all" : "%p, where nothing is";
            const int n = std::snprintf(what, sizeof what, "reads or writes at ");
            std::snprintf(what + n, sizeof what - n, why, info->si_addr);
        }
        end(what, in_library ? at : 0);
    }

    [[noreturn]] static void end(const char* what, uintptr_t at) {
        block.error = describe_thread() + " " + what + (at ? ", at " + describe_instruction(at) : ", in a function of the host");
        leave();
    }

    inline static const char *low_, *high_;
    inline static struct sigaction before_[std::size(kSignals)];
    stack_t stack_before_ = {};
    timer_t timer_ = {};
    bool has_timer_;
    char stack_[32 << 10];
};

}  // namespace simt
