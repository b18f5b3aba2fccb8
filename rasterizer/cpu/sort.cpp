// Depth order: a radix sort of the depths as floats, then runs of equal floats put right by their full precision. Stable, so
// ties keep the order of the input, Gaussians before convexes.
#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>

#include "state.h"

namespace e4dgs {
namespace {

struct Key {
    uint32_t bits, primitive;
};

// Positive floats sort like their bits.
void radix_sort(Buffer<Key>& keys, size_t n) {
    constexpr int kBits = 11, kBuckets = 1 << kBits;
    Buffer<Key> other(n);
    for (int shift = 0; shift < 32; shift += kBits) {
        size_t count[kBuckets] = {};
        for (size_t i = 0; i < n; ++i) ++count[(keys[i].bits >> shift) & (kBuckets - 1)];
        size_t sum = 0;
        for (size_t& c : count) {
            const size_t here = c;
            c = sum, sum += here;
        }
        for (size_t i = 0; i < n; ++i) other[count[(keys[i].bits >> shift) & (kBuckets - 1)]++] = keys[i];
        std::swap(keys, other);
    }
}

}  // namespace

void sort_by_depth(State& state) {
    const size_t total = state.depth.size();
    Buffer<Key> keys(total);
    size_t n = 0;
    for (size_t i = 0; i < total; ++i)
        if (!std::isnan(state.depth[i])) keys[n++] = {std::bit_cast<uint32_t>(float(state.depth[i])), uint32_t(i)};
    radix_sort(keys, n);

    for (size_t first = 0; first < n;) {
        size_t last = first + 1;
        while (last < n && keys[last].bits == keys[first].bits) ++last;
        if (last - first > 1)
            std::stable_sort(keys.data() + first, keys.data() + last,
                             [&](const Key& a, const Key& b) { return state.depth[a.primitive] < state.depth[b.primitive]; });
        first = last;
    }
    state.order.resize(n);
    for (size_t i = 0; i < n; ++i) state.order[i] = keys[i].primitive;
}

}  // namespace e4dgs
