// The nodes that weigh most at each point: see scene/motion/nodes/skinning.py. One thread per point keeps its best in registers; the nodes go
// through shared memory, a chunk at a time. Compile-time features: see nodes.cuh.
#include "nodes.cuh"

using namespace e4dgs;

// points [n, 3], hyper [n, HYPER], home [nodes, 3], home_hyper [nodes, HYPER], falloff [nodes]; link [n, LINKS], nearest first. Between
// nodes that are equally near it decides as the CPU's kernel does. A point that is not a number gets node 0.
extern "C" __global__ void __launch_bounds__(kNodeThreads)
    nearest_nodes(int n, int nodes, const float* points, const float* hyper, const float* home, const float* home_hyper,
                  const float* falloff, int* link) {
    __shared__ float there[kNodeThreads][4 + HYPER];  // place, falloff, hyper coordinates
    const int64 i = int64(blockIdx.x) * blockDim.x + threadIdx.x;
    const int64 mine = i < n ? i : n - 1;  // threads beyond the last point take part in the barriers
    const float x = points[3 * mine], y = points[3 * mine + 1], z = points[3 * mine + 2];
    float beside[kHyper], best[LINKS];
    int node[LINKS];
#pragma unroll
    for (int c = 0; c < HYPER; ++c) beside[c] = hyper[HYPER * mine + c];
#pragma unroll
    for (int k = 0; k < LINKS; ++k) best[k] = __int_as_float(0x7f800000), node[k] = 0;
    for (int first = 0; first < nodes; first += kNodeThreads) {
        const int count = nodes - first < kNodeThreads ? nodes - first : kNodeThreads, own = first + int(threadIdx.x);
        __syncthreads();  // nobody reads the chunk before
        if (int(threadIdx.x) < count) {
            for (int c = 0; c < 3; ++c) there[threadIdx.x][c] = home[3 * own + c];
            there[threadIdx.x][3] = falloff[own];
            for (int c = 0; c < HYPER; ++c) there[threadIdx.x][4 + c] = home_hyper[HYPER * own + c];
        }
        __syncthreads();
        for (int b = 0; b < count; ++b) {
            const float dx = x - there[b][0], dy = y - there[b][1], dz = z - there[b][2];
            float value = dx * dx + dy * dy + dz * dz;
#pragma unroll
            for (int c = 0; c < HYPER; ++c) value += (beside[c] - there[b][4 + c]) * (beside[c] - there[b][4 + c]);
            value *= there[b][3];
            if (!(value < best[LINKS - 1])) continue;
            int number = first + b;
#pragma unroll
            for (int k = 0; k < LINKS; ++k) {  // insertion into the sorted list: farther nodes move down
                if (!(value < best[k])) continue;
                const float farther = best[k];
                const int other = node[k];
                best[k] = value, node[k] = number;
                value = farther, number = other;
            }
        }
    }
    if (i >= n) return;
#pragma unroll
    for (int k = 0; k < LINKS; ++k) link[LINKS * i + k] = node[k];
}
