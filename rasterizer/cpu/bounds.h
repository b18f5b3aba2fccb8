// Which tiles a convex may touch: for each row of tiles, the range of x that its support covers within the row's pixel centres. The
// support (alpha >= 1/255) is bounded by the polygon of the convex's edges, moved outward. For Gaussians, see project_spans.inl.
#pragma once
#include <algorithm>
#include <cmath>

#include "state.h"

namespace e4dgs {

// Tile t holds the pixel centres kTile t + 0.5 ... kTile t + kTile - 0.5.
inline int first_tile(double low) { return int(std::ceil((low - (kTile - 0.5)) / kTile)); }
inline int last_tile(double high) { return int(std::floor((high - 0.5) / kTile)); }

// The polygon in which L_i <= limit for every edge. The range is slightly too large if a corner lies between the rows.
class ConvexBounds {
public:
    explicit ConvexBounds(const ConvexRecord& r) : n_(0) {
        for (int i = 0; i < r.n; ++i) {
            if (r.A()[i] == 0) continue;
            const double inverse = 1.0 / r.A()[i], slope = -r.B()[i] * inverse;
            edges_[n_++] = {r.x0 + (r.limit - r.C()[i]) * inverse - slope * r.y0, slope, r.A()[i] > 0};
        }
    }
    bool x_range(double ya, double yb, double& low, double& high) const {
        low = -1e300, high = 1e300;
        for (int i = 0; i < n_; ++i) {
            const Edge& e = edges_[i];
            const double a = e.at + e.slope * ya, b = e.at + e.slope * yb;
            if (e.right)
                high = std::min(high, std::max(a, b));
            else
                low = std::max(low, std::min(a, b));
        }
        low -= kLoose, high += kLoose;
        return low <= high;
    }

private:
    static constexpr double kLoose = 1e-6;  // px
    struct Edge {
        double at, slope;  // x = at + slope y
        bool right;
    };
    Edge edges_[kMaxPoints];
    int n_;
};

}  // namespace e4dgs
