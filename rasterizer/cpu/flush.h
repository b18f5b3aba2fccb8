// Denormal numbers cost x86 about a hundred cycles each, and gradients are full of them: of nearly hidden primitives, times weights of
// distant nodes (half of the time of the backward pass through the nodes of `robot`), and of convexes, where a slot has no edge or one that
// is far from the leading one (nearly half of the time of a frame of convexes with gradients).
#pragma once

#if defined(__SSE2__)
#include <xmmintrin.h>
#endif

namespace e4dgs {

// During its lifetime, this thread reads and writes denormals as zero. Each thread of a parallel region needs its own object.
class FlushDenormals {
#if defined(__SSE2__)
  public:
    FlushDenormals() : before_(_mm_getcsr()) { _mm_setcsr(before_ | kFlushToZero | kDenormalsAreZero); }
    ~FlushDenormals() { _mm_setcsr(before_); }
    FlushDenormals(const FlushDenormals&) = delete;
    FlushDenormals& operator=(const FlushDenormals&) = delete;

  private:
    static constexpr unsigned kFlushToZero = 0x8000, kDenormalsAreZero = 0x0040;
    unsigned before_;
#endif
};

}  // namespace e4dgs
