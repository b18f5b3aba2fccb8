// Sums over blocks that run at once. A block publishes its own total, then adds those of the blocks before it until it meets one that has
// already published the sum of everything up to itself ("decoupled look-back", Merrill and Garland 2016). Blocks take their numbers in the
// order in which they start, so a block waits only for blocks that run or have run.
#pragma once
#include "device.cuh"

namespace e4dgs {

using uint64 = unsigned long long;

// A published number: 56 bits, and a tag that says what it is. Later passes use larger tags, so that nothing has to be cleared in between.
constexpr int kTagShift = 56;
__device__ inline uint64 tagged(uint64 value, uint64 tag) { return value | tag << kTagShift; }
__device__ inline uint64 tag_of(uint64 word) { return word >> kTagShift; }
__device__ inline uint64 value_of(uint64 word) { return word & ((uint64(1) << kTagShift) - 1); }
__device__ inline uint64 published(const uint64* word) { return *(const volatile uint64*)word; }

// The number of this block in the order of starting. All threads of the block call it; `shared` is theirs.
__device__ inline int64 take_number(uint64* counter, int64* shared) {
    if (threadIdx.x == 0) *shared = int64(atomicAdd(counter, uint64(1)));
    __syncthreads();
    return *shared;
}

// The sum over the threads before this one in the block, of THREADS threads; `shared` [THREADS / 32] is theirs.
template <int THREADS>
__device__ inline int64 sum_before(int64 value, int64* shared) {
    const int lane = int(threadIdx.x) % 32, warp = int(threadIdx.x) / 32;
    int64 sum = value;
    for (int offset = 1; offset < 32; offset *= 2) {
        const int64 other = __shfl_up_sync(kAllLanes, sum, offset);
        if (lane >= offset) sum += other;
    }
    __syncthreads();  // nobody reads what an earlier call left in `shared`
    if (lane == 31) shared[warp] = sum;
    __syncthreads();
    int64 before = 0;
    for (int w = 0; w < THREADS / 32; ++w) before += w < warp ? shared[w] : 0;
    return before + sum - value;
}

// The sum of the totals that the blocks before this one have published (tags 1: its own, 2: of everything up to itself). A whole warp calls it.
__device__ inline int64 sum_of_earlier(const uint64* words, int64 block) {
    const int lane = int(threadIdx.x) % 32;
    int64 before = 0;
    for (int64 nearest = block - 1; nearest >= 0; nearest -= 32) {
        const int64 other = nearest - lane;
        uint64 word = tagged(0, 2);  // there is nothing before the first block
        if (other >= 0) word = published(words + other);
        while (!tag_of(word)) word = published(words + other);
        const uint32 whole = __ballot_sync(kAllLanes, tag_of(word) == 2);
        const int last = whole ? __ffs(int(whole)) - 1 : 31;
        int64 value = lane <= last ? int64(value_of(word)) : 0;
        for (int offset = 16; offset; offset /= 2) value += __shfl_xor_sync(kAllLanes, value, offset);
        before += value;
        if (whole) break;
    }
    return before;
}

// The sum of `value` over all threads of the grid before this one, in the order of the blocks' numbers. words [blocks] is zero at first.
// shared [THREADS / 32 + 2] is theirs; afterwards its last two are the sum over the earlier blocks and over this one.
template <int THREADS>
__device__ inline int64 sum_before_in_grid(int64 value, int64 block, uint64* words, int64* shared) {
    int64 &earlier = shared[THREADS / 32], &own = shared[THREADS / 32 + 1];
    const int64 before = sum_before<THREADS>(value, shared);
    if (threadIdx.x == THREADS - 1) own = before + value;
    __syncthreads();
    if (threadIdx.x < 32) {
        if (threadIdx.x == 0 && block) atomicExch(words + block, tagged(uint64(own), 1));
        const int64 sum = sum_of_earlier(words, block);
        if (threadIdx.x == 0) atomicExch(words + block, tagged(uint64(sum + own), 2)), earlier = sum;
    }
    __syncthreads();
    return earlier + before;
}

}  // namespace e4dgs
