// An array that, unlike std::vector, does not zero its memory: most of what a frame allocates is written before it is read.
#pragma once
#include <cstddef>
#include <type_traits>
#include <utility>

#include "pool.h"

namespace e4dgs {

template <class T>
class Buffer {
    static_assert(std::is_trivially_copyable_v<T>);

public:
    Buffer() = default;
    explicit Buffer(size_t n) { resize(n); }
    Buffer(Buffer&& other) noexcept { swap(other); }
    Buffer& operator=(Buffer&& other) noexcept { return swap(other), *this; }
    ~Buffer() { give_memory(memory_); }

    void resize(size_t n) {  // the old content is lost
        give_memory(memory_);
        memory_ = {}, size_ = n;
        if (n) memory_ = take_memory((n * sizeof(T) + 63) / 64 * 64);
    }
    T* data() { return static_cast<T*>(memory_.data); }
    const T* data() const { return static_cast<const T*>(memory_.data); }
    size_t size() const { return size_; }
    T& operator[](size_t i) { return data()[i]; }
    const T& operator[](size_t i) const { return data()[i]; }
    T* begin() { return data(); }
    T* end() { return data() + size_; }

private:
    void swap(Buffer& other) noexcept { std::swap(memory_, other.memory_), std::swap(size_, other.size_); }
    Memory memory_;
    size_t size_ = 0;
};

}  // namespace e4dgs
