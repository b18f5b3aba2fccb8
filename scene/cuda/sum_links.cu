// The gradients of nodes as sums in a fixed order, of rows that skinning.cu has written.
#include "nodes.cuh"

namespace e4dgs {

constexpr int kSlots = 32;  // rows of a node that are read at once
constexpr int kSumThreads = kSlots * kRow;

// The first place in sorted [count] whose value is at least `value`.
__device__ __forceinline__ int64 first_of(const int* sorted, int64 count, int value) {
    int64 low = 0, high = count;
    while (low < high) {
        const int64 middle = (low + high) / 2;
        if (sorted[middle] < value)
            low = middle + 1;
        else
            high = middle;
    }
    return low;
}

}  // namespace e4dgs

using namespace e4dgs;

// Adds the rows [count, kRow] of each node, in double, and writes sums [nodes, kRow]. One block per node. sorted [count]: the links in
// ascending order. order [count]: the place of each in rows.
extern "C" __global__ void __launch_bounds__(kSumThreads)
    sum_links(int64 count, const int* sorted, const int64* order, const float* rows, float* sums) {
    __shared__ double parts[kSlots][kRow];
    const int node = int(blockIdx.x), slot = int(threadIdx.x) / kRow, column = int(threadIdx.x) % kRow;
    const int64 end = first_of(sorted, count, node + 1);
    double sum = 0.0;
    for (int64 at = first_of(sorted, count, node) + slot; at < end; at += kSlots) sum += double(rows[order[at] * kRow + column]);
    parts[slot][column] = sum;
    __syncthreads();
    if (slot) return;
    for (int s = 1; s < kSlots; ++s) sum += parts[s][column];
    sums[int64(node) * kRow + column] = float(sum);
}
