// Where buffers get their memory: what a frame gave back is kept for the next one, in huge pages, because first touches of fresh
// pages and misses of the address cache cost as much as some of the kernels.
#pragma once
#include <cstddef>
#include <stdexcept>

namespace e4dgs {

struct Memory {
    void* data = nullptr;
    size_t capacity = 0;  // bytes
};

Memory take_memory(size_t bytes);  // aligned to 64 bytes; throws std::bad_alloc
void give_memory(Memory memory);
size_t release_memory();    // what is kept goes back to the system; bytes
size_t most_kept_memory();  // bytes; 0 in builds whose sanitizer watches the end of every buffer
size_t free_memory();       // bytes that this process could still get, as far as the system says

// What would not fit is refused before it is tried: Python sees a MemoryError.
class TooLarge : public std::runtime_error {
    using std::runtime_error::runtime_error;
};

}  // namespace e4dgs
