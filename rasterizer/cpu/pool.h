// The memory pool for buffers. Memory that a frame gives back is kept for the next one, in huge pages, because page faults on fresh
// memory and TLB misses cost as much as some of the kernels.
#pragma once
#include <cstddef>
#include <stdexcept>
#include <string>

namespace e4dgs {

struct Memory {
    void* data = nullptr;
    size_t capacity = 0;  // bytes
};

Memory take_memory(size_t bytes);  // aligned to 64 bytes; throws std::bad_alloc
void give_memory(Memory memory);
size_t release_memory();    // returns all kept memory to the system; the number of bytes
size_t most_kept_memory();  // largest number of bytes kept; 0 in builds whose sanitizer watches the end of every buffer
size_t free_memory(const std::string& root = "");  // bytes that this process could still get, according to the files below `root`

// Thrown before trying to allocate something that cannot fit. Python sees a MemoryError.
class TooLarge : public std::runtime_error {
    using std::runtime_error::runtime_error;
};

}  // namespace e4dgs
