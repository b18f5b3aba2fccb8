// Finds which of a few points in the plane are corners of their convex hull.
#pragma once
#include "constants.h"

namespace e4dgs {

// Twice the signed area of the triangle a b c. Plane: at.x(i), at.y(i) are the coordinates of point i.
template <class Plane>
E4DGS_HD auto turn(const Plane& at, int a, int b, int c) {
    return (at.x(b) - at.x(a)) * (at.y(c) - at.y(a)) - (at.y(b) - at.y(a)) * (at.x(c) - at.x(a));
}

// Graham's scan in Andrew's variant, counterclockwise from the leftmost point (the lowest one if there are several). Only extreme points
// are corners, with a tolerance for rounding (kFlatTurn), and only one of several coincident points. Returns their number; 0 if the hull
// has no area.
template <class Plane>
E4DGS_HD int hull_corners(const Plane& at, int points, int* corner) {
    auto low_x = at.x(0), high_x = low_x, low_y = at.y(0), high_y = low_y;
    for (int i = 1; i < points; ++i) {
        low_x = smaller(low_x, at.x(i)), high_x = larger(high_x, at.x(i));
        low_y = smaller(low_y, at.y(i)), high_y = larger(high_y, at.y(i));
    }
    const auto extent = larger(high_x - low_x, high_y - low_y), flat = decltype(extent)(kFlatTurn) * extent * extent;
    int order[kMaxPoints], m = 0;
    for (int i = 0; i < points; ++i) {
        int to = m;
        while (to > 0 && (at.x(order[to - 1]) > at.x(i) || (at.x(order[to - 1]) == at.x(i) && at.y(order[to - 1]) > at.y(i)))) --to;
        if (to > 0 && at.x(order[to - 1]) == at.x(i) && at.y(order[to - 1]) == at.y(i)) continue;
        for (int k = m; k > to; --k) order[k] = order[k - 1];
        order[to] = i;
        ++m;
    }
    if (m < 3) return 0;
    int stack[2 * kMaxPoints], size = 0;
    for (int k = 0; k < m; ++k) {
        while (size > 1 && !(turn(at, stack[size - 2], stack[size - 1], order[k]) > flat)) --size;  // also for NaN
        stack[size++] = order[k];
    }
    const int lower = size;
    for (int k = m - 2; k >= 0; --k) {
        while (size > lower && !(turn(at, stack[size - 2], stack[size - 1], order[k]) > flat)) --size;
        stack[size++] = order[k];
    }
    const int n = size - 1;  // the last point on the stack is the first one again
    if (n < 3 || n > m) return 0;
    for (int k = 0; k < n; ++k) corner[k] = stack[k];
    return n;
}

}  // namespace e4dgs
