// What the kernels of skinning know of nodes. Compile-time features: LINKS (nodes that carry a point) and HYPER (coordinates that count for
// the distance in addition to x, y, z).
#pragma once
#include "device.cuh"

#if !defined(LINKS)
#define LINKS 4
#endif
#if !defined(HYPER)
#define HYPER 2
#endif

namespace e4dgs {

constexpr int kNodeThreads = 128;
constexpr int kHyper = HYPER ? HYPER : 1;  // length of arrays, which cannot be 0
constexpr int kRow = 12;                 // gradient of a node: shift 3, falloff 1, turn 4, hyper coordinates 4

}  // namespace e4dgs
