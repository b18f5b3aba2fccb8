// Where buffers get their memory: what a frame gave back is kept for the next one, in huge pages, because first touches of fresh
// pages and misses of the address cache cost as much as some of the kernels.
#pragma once
#include <cstddef>

namespace e4dgs {

struct Memory {
    void* data = nullptr;
    size_t capacity = 0;  // bytes
};

Memory take_memory(size_t bytes);  // aligned to 64 bytes; throws std::bad_alloc
void give_memory(Memory memory);
size_t release_memory();  // what is kept goes back to the system; bytes

}  // namespace e4dgs
