// Sorts by depth: a radix sort of the depths as floats, then runs of equal floats are sorted by full precision. The sort is stable, so
// ties keep the order of the input (Gaussians before convexes), and the result is the same for any number of threads.
#include <algorithm>
#include <bit>
#include <cmath>
#include <vector>

#include "parallel.h"
#include "state.h"

namespace e4dgs {
namespace {

struct Key {
    uint32_t bits, primitive;
};

constexpr int kMostBits = 11;  // largest number of bits in a digit

struct Ranges {  // contiguous ranges of n items, at least 262144 each: for fewer, waking the threads eight times costs more than it saves
    int64_t n, count;
    Ranges(int64_t size, int threads) : n(size), count(std::max<int64_t>(1, std::min<int64_t>(threads, size / 262144))) {}
    int64_t begin(int64_t r) const { return n * r / count; }
};

// Sorts by the digit of `width` bits that starts at bit `shift`: each range counts, then fills its own places.
void scatter(const Buffer<Key>& from, Buffer<Key>& to, int64_t n, int shift, int width, int threads) {
    const Ranges ranges(n, threads);
    const uint32_t buckets = 1u << width, mask = buckets - 1;
    std::vector<uint32_t> at(size_t(ranges.count) * buckets, 0u);
    parallel_blocks(ranges.count, 1, threads, [&](int64_t r, int64_t, int64_t) {
        uint32_t* count = at.data() + r * buckets;
        for (int64_t i = ranges.begin(r); i < ranges.begin(r + 1); ++i) ++count[(from[i].bits >> shift) & mask];
    });
    uint32_t sum = 0;
    for (uint32_t b = 0; b < buckets; ++b)
        for (int64_t r = 0; r < ranges.count; ++r) {
            const uint32_t here = at[r * buckets + b];
            at[r * buckets + b] = sum, sum += here;
        }
    parallel_blocks(ranges.count, 1, threads, [&](int64_t r, int64_t, int64_t) {
        uint32_t* next = at.data() + r * buckets;
        for (int64_t i = ranges.begin(r); i < ranges.begin(r + 1); ++i) to[next[(from[i].bits >> shift) & mask]++] = from[i];
    });
}

// Collects the keys of the primitives that were not culled, in input order. A key is the depth's bits minus those of the smallest depth;
// positive floats sort like their bits.
int64_t collect(const State& state, Buffer<Key>& keys, uint32_t& most, int threads) {
    const int64_t total = int64_t(state.depth.size());
    const Ranges ranges(total, threads);
    std::vector<int64_t> first(ranges.count + 1, 0);
    std::vector<uint32_t> low(ranges.count, ~0u), high(ranges.count, 0u);
    parallel_blocks(ranges.count, 1, threads, [&](int64_t r, int64_t, int64_t) {
        for (int64_t i = ranges.begin(r); i < ranges.begin(r + 1); ++i) {
            if (std::isnan(state.depth[i])) continue;
            const uint32_t bits = std::bit_cast<uint32_t>(float(state.depth[i]));
            ++first[r + 1], low[r] = std::min(low[r], bits), high[r] = std::max(high[r], bits);
        }
    });
    for (int64_t r = 0; r < ranges.count; ++r) first[r + 1] += first[r];
    const uint32_t least = *std::min_element(low.begin(), low.end());
    most = first.back() ? *std::max_element(high.begin(), high.end()) - least : 0;
    parallel_blocks(ranges.count, 1, threads, [&](int64_t r, int64_t, int64_t) {
        int64_t at = first[r];
        for (int64_t i = ranges.begin(r); i < ranges.begin(r + 1); ++i)
            if (!std::isnan(state.depth[i])) keys[at++] = {std::bit_cast<uint32_t>(float(state.depth[i])) - least, uint32_t(i)};
    });
    return first.back();
}

}  // namespace

void sort_by_depth(State& state, int threads) {
    const size_t total = state.depth.size();
    Buffer<Key> keys(total), other(total);
    uint32_t most;
    const int64_t n = collect(state, keys, most, threads);
    const int bits = int(std::bit_width(most)), passes = (bits + kMostBits - 1) / kMostBits;
    for (int pass = 0; pass < passes; ++pass) {
        const int from = bits * pass / passes, to = bits * (pass + 1) / passes;
        scatter(keys, other, n, from, to - from, threads);
        std::swap(keys, other);
    }
    for (int64_t first = 0; first < n;) {
        int64_t last = first + 1;
        while (last < n && keys[last].bits == keys[first].bits) ++last;
        if (last - first > 1)
            std::stable_sort(keys.data() + first, keys.data() + last,
                             [&](const Key& a, const Key& b) { return state.depth[a.primitive] < state.depth[b.primitive]; });
        first = last;
    }
    state.order.resize(n);
    parallel_blocks(n, 16384, threads, [&](int64_t begin, int64_t end, int64_t) {
        for (int64_t i = begin; i < end; ++i) state.order[i] = keys[i].primitive;
    });
}

}  // namespace e4dgs
