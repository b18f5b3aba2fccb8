// exp of a float, in loops that are vectorised.
#pragma once
#include <bit>
#include <cstdint>
#include <limits>

#include "clones.h"

namespace e4dgs {

// exp(x) to 2e-7 of its value for |x| <= 80. Beyond that it is exp(80) or exp(-80); of a NaN it is exp(80).
E4DGS_INLINE float exp_of(float x) {
    x = x < 80.0f ? x : 80.0f;
    x = (x > -80.0f ? x : -80.0f) * 1.44269504f;
    const float y = x + 0.5f;
    const int32_t cut = int32_t(y), whole = cut - (float(cut) > y);  // std::floor would not be vectorised
    const float f = (x - float(whole)) * 0.69314718f;
    float p = 1.0f / 720.0f;
    p = p * f + 1.0f / 120.0f, p = p * f + 1.0f / 24.0f, p = p * f + 1.0f / 6.0f, p = p * f + 0.5f, p = p * f + 1.0f, p = p * f + 1.0f;
    return p * std::bit_cast<float>((whole + 127) << 23);
}

// exp(x) as exp_of, but infinite where x > 87, 0 where x < -87, and NaN of a NaN.
E4DGS_INLINE float exp_anywhere(float x) {
    constexpr float kMost = 87.0f;
    const float half = exp_of(0.5f * (x < kMost ? (x > -kMost ? x : -kMost) : kMost));
    const float inside = half * half, cut = x < -kMost ? 0.0f : inside;
    const float above = x > kMost ? std::numeric_limits<float>::infinity() : cut;
    return x == x ? above : x;
}

}  // namespace e4dgs
