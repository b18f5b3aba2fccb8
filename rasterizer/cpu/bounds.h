// Which tiles a primitive may touch: for each row of tiles, the range of x that its support (alpha >= 1/255) takes within the
// row's pixel centres. Exact for Gaussians; for convexes the polygon of the edges moved out to the support, a little larger.
#pragma once
#include <algorithm>
#include <cmath>

#include "state.h"

namespace e4dgs {

// Tile t holds the pixel centres kTile t + 0.5 ... kTile t + kTile - 0.5.
inline int first_tile(double low) { return int(std::ceil((low - (kTile - 0.5)) / kTile)); }
inline int last_tile(double high) { return int(std::floor((high - 0.5) / kTile)); }

// The ellipse u^2 + v^2 <= radius^2.
class GaussianBounds {
public:
    explicit GaussianBounds(const GaussianRecord& r) : r_(r), radius2_(double(r.radius) * r.radius) {
        const double h = std::sqrt(r.f[1] * r.f[1] + r.f[2] * r.f[2]);
        high_y_ = r.radius / r.f[2];
        rightmost_y_ = -high_y_ * r.f[1] / h;
        inverse_ = 1.0 / r.f[0];
    }
    // x range over the rows ya..yb (pixel centres); false: none.
    bool x_range(double ya, double yb, double& low, double& high) const {
        const double a = std::max(ya - r_.y, -high_y_), b = std::min(yb - r_.y, high_y_);
        if (!(a <= b)) return false;
        const double right = std::clamp(rightmost_y_, a, b), left = std::clamp(-rightmost_y_, a, b);
        high = r_.x + (half(right) - r_.f[1] * right) * inverse_;
        low = r_.x + (-half(left) - r_.f[1] * left) * inverse_;
        return true;
    }

private:
    double half(double dy) const {
        const double v = r_.f[2] * dy;
        return std::sqrt(std::max(0.0, radius2_ - v * v));
    }
    const GaussianRecord& r_;
    double radius2_, high_y_, rightmost_y_, inverse_;
};

// The polygon L_i <= limit for every edge, a little larger where a corner lies between the rows.
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
