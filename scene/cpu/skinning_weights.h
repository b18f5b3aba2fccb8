// The first part of skinning: the nodes as the kernels read them, and the weights with which they carry positions.
#pragma once
#include <cstdint>
#include <vector>

#include "skinning.h"

namespace e4dgs {

constexpr int kBlock = 64;  // positions whose weights are computed together

// A node's rigid motion, or its gradient, in one vector: rotation matrix 9, the translation added after it 3, quaternion 4. Blending the
// nodes of a position is then a weighted sum of such vectors.
constexpr int kRigid = 16;
enum { kR = 0, kShift = 9, kQuat = 12 };

// What the weights depend on, in one row of a node: place 3, hyper coordinates (zero if there are fewer), falloff.
constexpr int kPlace = 8;
enum { kHyper = 3, kFalloff = 7 };
static_assert(kHyper + kMostHyper <= kFalloff);

// All positions are relative to the first node, so that a scene far from the origin loses no precision.
struct Frames {
    float origin[3];
    std::vector<float> rigid, place;  // [nodes, 16], [nodes, 8]
};

// Positions that are worked on together.
struct Block {
    int count;
    int64_t row[kBlock];
};

Frames frames_of(const Skinning& in);

struct Weights {
    float value[kMostLinks][kBlock];  // sum to one over the links
    float d2[kMostLinks][kBlock];
};

// The weights at the positions of `block`. The places after the last repeat it.
void weigh(const Skinning& in, const Frames& frames, const Block& block, Weights& out);

}  // namespace e4dgs
