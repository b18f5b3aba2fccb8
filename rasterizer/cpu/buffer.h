// Memory without the zeroing of std::vector: most of what a frame allocates is written before it is read.
#pragma once
#include <cstddef>
#include <cstdlib>
#include <new>
#include <type_traits>
#include <utility>

namespace e4dgs {

template <class T>
class Buffer {
    static_assert(std::is_trivially_copyable_v<T>);

public:
    Buffer() = default;
    explicit Buffer(size_t n) { resize(n); }
    Buffer(Buffer&& other) noexcept { swap(other); }
    Buffer& operator=(Buffer&& other) noexcept { return swap(other), *this; }
    ~Buffer() { std::free(data_); }

    void resize(size_t n) {  // the old content is lost
        std::free(data_);
        data_ = nullptr, size_ = n;
        if (n == 0) return;
        data_ = static_cast<T*>(std::aligned_alloc(64, (n * sizeof(T) + 63) / 64 * 64));
        if (!data_) throw std::bad_alloc();
    }
    T* data() { return data_; }
    const T* data() const { return data_; }
    size_t size() const { return size_; }
    T& operator[](size_t i) { return data_[i]; }
    const T& operator[](size_t i) const { return data_[i]; }
    T* begin() { return data_; }
    T* end() { return data_ + size_; }

private:
    void swap(Buffer& other) noexcept { std::swap(data_, other.data_), std::swap(size_, other.size_); }
    T* data_ = nullptr;
    size_t size_ = 0;
};

}  // namespace e4dgs
