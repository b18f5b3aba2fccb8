// What a compiled kernel and the scheduler know of each other: the collectives in which threads meet, and the table of kernels.
#pragma once
#include <cstdint>
#include <source_location>

#include "vectors.h"

extern uint3 threadIdx, blockIdx;  // of the thread that runs now
extern dim3 blockDim, gridDim;
constexpr int warpSize = 32;

namespace simt {

using Place = std::source_location;  // where in the kernel's source a collective stands

enum class Meeting : uint8_t {
    shfl, shfl_up, shfl_down, shfl_xor, ballot, any, all, match_any, syncwarp,  // of lanes
    syncthreads, syncthreads_or, syncthreads_and, syncthreads_count,            // of the block
};
const char* name_of(Meeting meeting);

// Waits for all lanes in `mask`. What lane i brought is then at [i], until this thread's next meeting.
const uint64_t* meet(Meeting meeting, uint32_t mask, uint64_t brought, const Place& place);

struct Count {
    int those, all;  // threads for which the predicate held, threads that took part
};
// Waits for all threads of the block that have not ended.
Count gather(Meeting meeting, bool predicate, const Place& place);

// Ends the launch with an error that names kernel, block and thread.
[[noreturn]] void fail(const char* what, const Place& place);

struct Parameter {
    const char* name;
    char passed;   // 'p' by pointer, 's' as a scalar
    char element;  // of what it is or points to: 'f' floating, 'i' integer, '?' something else
    int32_t size;  // bytes of it, 0 where unknown
};

struct Kernel {
    const char* name;
    void (*call)(void** arguments);
    const Parameter* parameters;
    int32_t n_parameters;
    int32_t bound;  // the most threads a block may have
};

extern const Kernel* const kernels;  // the compiled source's
extern const int n_kernels;

}  // namespace simt
