// The state of the block that runs: its warps, what each thread waits for, and who runs next.
#pragma once
#include <string>

#include "fiber.h"
#include "runtime.h"

namespace simt {

constexpr int kWarp = 32, kMaxThreads = 1024;

struct Thread {
    Fiber fiber;
    Meeting meeting;  // these three mean something while it waits
    uint32_t mask;
    Place place;
};

struct Warp {
    // Bits of lanes. Each lane that is present is in exactly one of the others.
    uint32_t present, ready, waiting, at_barrier, ended;
    uint64_t brought[kWarp], met[kWarp];  // by lanes that wait; by those of the last meeting that took place
    Thread lanes[kWarp];
};

// A sequence of numbers that depends on the seed alone.
struct Random {
    uint64_t state;
    uint32_t below(uint32_t n) {  // splitmix64 (Steele, Lea, Flood 2014)
        uint64_t z = state += 0x9e3779b97f4a7c15u;
        z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9u;
        z = (z ^ (z >> 27)) * 0x94d049bb133111ebu;
        return uint32_t(((z ^ (z >> 31)) >> 32) * n >> 32);
    }
};

struct Block {
    const Kernel* kernel;
    void** arguments;
    int n_warps;
    Warp warps[kMaxThreads / kWarp];
    Fiber launcher;  // who wants the block done

    Warp* warp;         // of the thread that runs
    int order[kWarp];   // lanes of this warp's round
    int at, n_order;    // in it
    bool shuffled;      // threads run in an order that `random` chooses, or in their own
    bool keep_to_warp;  // until it can do nothing more; or any warp may be next, as each round chooses
    Random random;
    Count count;        // of the last barrier

    bool busy;          // with data that an interrupt must not leave half changed
    std::string error;  // empty unless the launch failed
};
extern Block block;

// The linker's: first byte of the library, first byte behind its code, and behind its variables.
extern "C" __attribute__((visibility("hidden"))) const char __ehdr_start, etext, end;

inline int lane_of(uint32_t bits) { return __builtin_ctz(bits); }

// Ends the launch; `error` is set.
[[noreturn]] void leave();

// How the waiting lanes of a warp, or the threads of the block, stand where they cannot go on.
std::string describe(const Warp& warp);
std::string describe_block();
std::string describe_thread();  // that runs
std::string describe_place(const Place& place);
std::string describe_instruction(uintptr_t at);  // in the library; places.py makes a line of the source of it
std::string describe_shared(size_t offset);      // places.py makes a name of it
bool same_file(const char* a, const char* b);
inline bool same_place(const Place& a, const Place& b) {
    return a.line() == b.line() && (a.file_name() == b.file_name() || same_file(a.file_name(), b.file_name()));
}

}  // namespace simt
