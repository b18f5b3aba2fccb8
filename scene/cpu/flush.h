// Numbers below the smallest normal one cost x86 some hundred cycles each. Gradients of what is all but hidden, times weights of nodes far
// away, are full of them: about half of the backward pass through the nodes was theirs on `robot`.
#pragma once

#if defined(__SSE2__)
#include <xmmintrin.h>
#endif

namespace e4dgs {

// While it lives, this thread reads and writes zero in their place. Each thread of a parallel region needs its own.
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
