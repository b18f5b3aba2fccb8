// Where the primitives that may be visible are kept: without gaps, in the order of their indices, so that what a view does not show takes
// neither memory nor time after the projection.
#pragma once
#include "records.cuh"
#include "scan.cuh"

namespace e4dgs {

constexpr int kProjectThreads = 128;  // THREADS in forward.py

// Of one kind of primitive. n: all of them. room: how many can be kept; the rest, with the highest indices, are left out. workspace [1 +
// blocks] is zero at first. slots [n]: where a primitive's record is, -1 if it has none. ids: of each slot, the primitive. depth, boxes: of
// each slot. visible [n]: set to 0. Slots of ids, depth and boxes are counted over both kinds, Gaussians first.
struct Slots {
    int n, room;
    uint64* workspace;
    int *slots, *ids;
    double* depth;
    TileBox* boxes;
    uint8* visible;

    // The number of this block. All threads call it.
    __device__ int64 take_block() const {
        __shared__ int64 number;
        return take_number(workspace, &number);
    }

    __device__ bool ends(int64 block) const { return block == gridDim.x - 1 && threadIdx.x == 0; }

    // The slot among those of its kind for primitive i, or -1. All threads call it. first: the number of slots of the other kind before
    // these. seen: for the thread that `ends` the last block, how many primitives are `there`.
    __device__ int take(int64 block, int64 i, int64 first, bool there, const TileBox& box, double z, int64& seen) const {
        __shared__ int64 shared[kProjectThreads / 32 + 2];
        const int64 before = sum_before_in_grid<kProjectThreads>(there, block, workspace + 1, shared);
        seen = shared[kProjectThreads / 32] + shared[kProjectThreads / 32 + 1];
        if (i >= n) return -1;
        const int slot = there && before < room ? int(before) : -1;
        slots[i] = slot, visible[i] = 0;
        if (slot < 0) return -1;
        ids[first + slot] = int(i), depth[first + slot] = z, boxes[first + slot] = box;
        return slot;
    }
};

}  // namespace e4dgs
