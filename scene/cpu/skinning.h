// Linear blend skinning: positions move with their nearest nodes.
#pragma once
#include <cstdint>

namespace e4dgs {

constexpr int kMostLinks = 8;   // most nodes that carry a position
constexpr int kMostHyper = 4;   // most coordinates, in addition to x, y, z, that count for the distance

struct Skinning {
    int64_t n;                // positions
    int nodes, links, hyper;  // links <= kMostLinks, hyper <= kMostHyper
    const float* rest;        // [n, 3] world units
    const float* quats;       // [n, 4] w x y z of any norm, turned with the positions
    const float* rest_hyper;  // [n, hyper]
    const int32_t* link;      // [n, links] indices of nodes
    const float* home;        // [nodes, 3] rest positions of the nodes
    const float* home_hyper;  // [nodes, hyper]
    const float* falloff;     // [nodes] 1 / (2 radius^2)
    const float* turns;       // [nodes, 4] unit quaternions
    const float* shifts;      // [nodes, 3]
};

struct SkinningGrad {
    float *rest, *quats, *rest_hyper;
    float *home_hyper, *falloff, *turns, *shifts;  // sums over all positions
};

// moved [n, 3]; turned [n, 4]: quats turned by the blended unit quaternion.
void skin_forward(const Skinning& in, float* moved, float* turned, int threads);

// All of `out` is overwritten. Sums are in the same order for any number of threads.
void skin_backward(const Skinning& in, const float* g_moved, const float* g_turned, const SkinningGrad& out, int threads);

// link [n, links]: the nearest nodes of each position by distance over radius, in space and hyper coordinates together; nearest first.
void nearest_nodes(const Skinning& in, int32_t* link, int threads);

}  // namespace e4dgs
