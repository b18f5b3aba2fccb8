// Memory that the calling thread keeps from call to call, because fresh pages cost as much as the arithmetic.
#pragma once
#include <algorithm>
#include <cstddef>
#include <cstdlib>
#include <memory>
#include <new>
#include <utility>

namespace e4dgs {

// User: a type of whoever uses the memory, so that two of them at once do not take it from each other.
template <class User>
class KeptBuffer {
public:
    explicit KeptBuffer(size_t floats) : data_(floats <= kept_.second ? kept_.first.release() : fresh(floats)), size_(std::max(floats, kept_.second)) {
        kept_.second = 0;
    }
    ~KeptBuffer() {
        kept_.first.reset(size_ <= kMostKept ? data_ : (std::free(data_), nullptr));
        kept_.second = size_ <= kMostKept ? size_ : 0;
    }
    KeptBuffer(const KeptBuffer&) = delete;
    float* data() { return data_; }

private:
    struct Free {
        void operator()(float* p) const { std::free(p); }
    };
    static constexpr size_t kMostKept = size_t(32) << 20;  // floats
    static float* fresh(size_t floats) {
        void* p = std::aligned_alloc(64, (floats * sizeof(float) + 63) / 64 * 64);
        if (!p) throw std::bad_alloc();
        return static_cast<float*>(p);
    }
    inline static thread_local std::pair<std::unique_ptr<float, Free>, size_t> kept_{nullptr, 0};
    float* data_;
    size_t size_;
};

}  // namespace e4dgs
