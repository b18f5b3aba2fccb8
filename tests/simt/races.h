// Accesses to one place in memory by two threads, at least one of them a write, with nothing between that orders them. They are found
// whatever order the threads happened to run in. Kernels compiled with GCC's -fsanitize=thread tell what they access (hooks.cpp).
//
// What orders: __syncthreads all threads of the block, __syncwarp the lanes in its mask. Shuffles and votes do not (CUDA C++ Programming
// Guide, on warp functions: they imply no memory barrier). Atomic and volatile accesses are no race among themselves, and order nothing:
// what a kernel builds of them and fences is not understood. Two writes of the same value are no race either. Variables
// of the library itself are not watched.
#pragma once
#include <unordered_map>
#include <vector>

#include "block.h"

namespace simt {

class Races {
public:
    void start_launch(const char* stacks, size_t stack_bytes, const char* shared, size_t shared_bytes);
    void order_block() { ++epoch_; }
    void order_lanes(const Warp& w, uint32_t lanes);
    void access(uintptr_t at, size_t bytes, bool writes, bool atomic, uintptr_t by);
    void settle();  // before another thread runs

private:
    struct Access {
        uint32_t block, epoch, time;  // epoch: between two orderings of the block; time: of the lane, between its own
        uint16_t thread;
        bool atomic;
        uintptr_t by;  // instruction
    };
    // The accesses that later ones may still race with.
    struct Byte {
        std::vector<Access> writes, reads;
    };

    // Two writes without order, of which the second is about to take place.
    struct Overwrite {
        uintptr_t at;
        char old;
        Access before, now;
    };

    void access(uintptr_t at, int bytes, Byte& byte, const Access& now, bool writes);
    void check(uintptr_t at, int bytes, std::vector<Access>& all, bool wrote, const Access& now, bool writes);
    bool is_ordered(const Access& before, const Access& now) const;
    bool is_shared(uintptr_t at) const { return at - shared_ < shared_bytes_; }
    std::string place(uintptr_t at) const;
    [[noreturn]] void report(uintptr_t at, const Access& before, bool wrote, const Access& now, bool writes) const;

    std::unordered_map<uintptr_t, std::vector<Byte>> words_;  // one for its four bytes, until one of them is accessed alone
    std::vector<Overwrite> overwrites_;
    uint32_t epoch_ = 0, time_[kMaxThreads][kWarp];           // [thread][lane of its warp]: the lane's time that the thread knows
    uintptr_t stacks_, shared_;
    size_t stack_bytes_, shared_bytes_;
};
extern Races races;
extern bool watching;  // this library's kernels tell

}  // namespace simt
