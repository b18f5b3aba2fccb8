// A stable radix sort of keys with one number each, eight bits at a time: "onesweep" (Adinets and Merrill 2022), which reads and writes each
// key once a pass. Feature: KEY_BYTES (2, 4 or 8; keys count as unsigned, and doubles that are not negative sort like their bits).
#include "scan.cuh"

#if !defined(KEY_BYTES)
#define KEY_BYTES 8
#endif

namespace e4dgs {

#if KEY_BYTES == 2
using Key = uint16;
#elif KEY_BYTES == 4
using Key = uint32;
#else
using Key = uint64;
#endif

constexpr int kBits = 8, kBins = 1 << kBits, kPasses = int(sizeof(Key));
constexpr int kSortThreads = kBins, kSortWarps = kSortThreads / 32;  // a thread for each bin
constexpr int kItems = 8;  // keys of a thread; ITEMS in sort.py
constexpr int kBlockKeys = kSortThreads * kItems;
constexpr int kAtOnce = 4;  // earlier blocks whose counts are read at a time, because one read after another takes longer than the sorting

// The layout of the workspace, which is zero at first: each pass's counter of blocks and its counts of digits; then, for each block, a
// published number for each digit.
constexpr int kCounts = 8, kPublished = kCounts + 8 * kBins;

__device__ inline int digit_of(Key key, int pass) { return int(key >> (kBits * pass)) & (kBins - 1); }

}  // namespace e4dgs

using namespace e4dgs;

// Counts the digits of all passes. keys [room], of which the first `number` are sorted; null: all.
extern "C" __global__ void __launch_bounds__(kSortThreads) count_digits(int64 room, const int64* number, const Key* keys, uint64* workspace) {
    __shared__ uint32 counts[kPasses][kBins];
    const int thread = int(threadIdx.x);
    const int64 n = number ? *number : room;
    for (int pass = 0; pass < kPasses; ++pass) counts[pass][thread] = 0;
    __syncthreads();
    for (int64 i = int64(blockIdx.x) * kSortThreads + thread; i < n; i += int64(gridDim.x) * kSortThreads) {
        const Key key = keys[i];
        for (int pass = 0; pass < kPasses; ++pass) atomicAdd(&counts[pass][digit_of(key, pass)], 1u);
    }
    __syncthreads();
    for (int pass = 0; pass < kPasses; ++pass)
        if (counts[pass][thread]) atomicAdd(workspace + kCounts + pass * kBins + thread, uint64(counts[pass][thread]));
}

// Sorts by one digit. keys, values [room], of which the first `number` are sorted; values_in may be null: then a key's value is its index.
// keys_out may be null.
extern "C" __global__ void __launch_bounds__(kSortThreads, 3)
    sort_digit(int64 room, const int64* number, int pass, const Key* keys_in, const int* values_in, Key* keys_out, int* values_out, uint64* workspace) {
    __shared__ int warp_counts[kSortWarps][kBins];
    __shared__ Key keys[kBlockKeys];
    __shared__ int values[kBlockKeys];
    __shared__ int64 shift[kBins], scratch[kSortWarps], own_number;

    const int thread = int(threadIdx.x), lane = thread % 32, warp = thread / 32;
    const int64 block = take_number(workspace + pass, &own_number), first = block * kBlockKeys, n = number ? *number : room;
    if (first >= n) return;  // nobody waits for this block
    const int here = n - first < kBlockKeys ? int(n - first) : kBlockKeys;
    for (int w = 0; w < kSortWarps; ++w) warp_counts[w][thread] = 0;
    __syncthreads();

    // Each warp ranks its keys among those of the same digit. Keys beyond the end have the largest digit and rank last.
    Key key[kItems];
    int rank[kItems];
    const int own = warp * 32 * kItems + lane;
#pragma unroll
    for (int j = 0; j < kItems; ++j) key[j] = own + 32 * j < here ? keys_in[first + own + 32 * j] : Key(~Key(0));
#pragma unroll
    for (int j = 0; j < kItems; ++j) {
        const int digit = digit_of(key[j], pass);
        const uint32 alike = __match_any_sync(kAllLanes, uint32(digit));
        const int leader = __ffs(int(alike)) - 1;
        int before = 0;
        if (lane == leader) {
            before = warp_counts[warp][digit];
            warp_counts[warp][digit] = before + __popc(alike);
        }
        rank[j] = __shfl_sync(kAllLanes, before, leader) + __popc(alike & ((1u << lane) - 1));
        __syncwarp();  // the next leader of this digit may be another lane
    }
    __syncthreads();

    // From here, a thread stands for a digit.
    int total = 0;
    for (int w = 0; w < kSortWarps; ++w) {
        const int count = warp_counts[w][thread];
        warp_counts[w][thread] = total;
        total += count;
    }
    const int start = int(sum_before<kSortThreads>(total, scratch));  // of the digit, among the block's keys in order
    for (int w = 0; w < kSortWarps; ++w) warp_counts[w][thread] += start;
    if (thread == kBins - 1) total -= kBlockKeys - here;

    const uint64 local = 2 * pass + 1, whole = 2 * pass + 2;
    uint64* const words = workspace + kPublished + thread;
    atomicExch(words + block * kBins, tagged(uint64(total), block ? local : whole));
    int64 before = 0;
    bool found = block == 0;
    for (int64 nearest = block - 1; !found; nearest -= kAtOnce) {
        uint64 word[kAtOnce];
#pragma unroll
        for (int j = 0; j < kAtOnce; ++j) word[j] = nearest - j >= 0 ? published(words + (nearest - j) * kBins) : tagged(0, whole);
#pragma unroll
        for (int j = 0; j < kAtOnce; ++j) {
            if (found) continue;
            while (tag_of(word[j]) < local) word[j] = published(words + (nearest - j) * kBins);
            before += int64(value_of(word[j]));
            found = tag_of(word[j]) == whole;
        }
    }
    if (block) atomicExch(words + block * kBins, tagged(uint64(before + total), whole));
    shift[thread] = sum_before<kSortThreads>(int64(workspace[kCounts + pass * kBins + thread]), scratch) + before - start;
    __syncthreads();

    // Through shared memory, so that what goes to one place is written together.
#pragma unroll
    for (int j = 0; j < kItems; ++j) {
        const int64 at = first + own + 32 * j;
        const int to = warp_counts[warp][digit_of(key[j], pass)] + rank[j];
        keys[to] = key[j];
        if (own + 32 * j < here) values[to] = values_in ? values_in[at] : int(at);
    }
    __syncthreads();
    for (int i = thread; i < here; i += kSortThreads) {
        const int64 to = shift[digit_of(keys[i], pass)] + i;
        if (keys_out) keys_out[to] = keys[i];
        values_out[to] = values[i];
    }
}
