// The parallel loop for all stages. Work is split into blocks whose boundaries do not depend on the number of threads, so whatever
// is accumulated per block is the same for any number.
#pragma once
#include <atomic>
#include <cstdint>

namespace e4dgs {

// Calls f(first, last, block) for [0, n) in blocks of `grain`.
template <class F>
void parallel_blocks(int64_t n, int64_t grain, int threads, F&& f) {
    const int64_t blocks = (n + grain - 1) / grain;
    if (threads <= 1 || blocks <= 1) {
        for (int64_t b = 0; b < blocks; ++b) f(b * grain, b * grain + grain < n ? b * grain + grain : n, b);
        return;
    }
    std::atomic<int64_t> next{0};
#pragma omp parallel num_threads(threads)
    for (int64_t b; (b = next.fetch_add(1, std::memory_order_relaxed)) < blocks;)
        f(b * grain, b * grain + grain < n ? b * grain + grain : n, b);
}

}  // namespace e4dgs
