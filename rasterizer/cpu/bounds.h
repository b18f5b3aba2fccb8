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

// The tiles that the bounding box of `bounds` meets; false: none.
template <class Bounds>
bool tile_box(const Bounds& bounds, int width, int height, TileBox& box) {
    const double low_x = std::max(bounds.low_x(), 0.5), high_x = std::min(bounds.high_x(), width - 0.5);
    const double low_y = std::max(bounds.low_y(), 0.5), high_y = std::min(bounds.high_y(), height - 0.5);
    if (!(low_x <= high_x && low_y <= high_y)) return false;
    box = {uint16_t(first_tile(low_x)), uint16_t(last_tile(high_x) + 1), uint16_t(first_tile(low_y)), uint16_t(last_tile(high_y) + 1)};
    return box.x0 < box.x1 && box.y0 < box.y1;
}

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

// The image, clipped by L_i <= limit for every edge.
class ConvexBounds {
public:
    ConvexBounds(const ConvexRecord& r, int width, int height) {
        const double w = width - 0.5, h = height - 0.5;
        const double corners[4][2] = {{0.5, 0.5}, {w, 0.5}, {w, h}, {0.5, h}};
        n_ = 4;
        for (int k = 0; k < 4; ++k) x_[k] = corners[k][0], y_[k] = corners[k][1];
        for (int i = 0; i < r.n && n_ > 0; ++i) clip(r, i);
        if (n_ == 0) return;
        low_x_ = *std::min_element(x_, x_ + n_), high_x_ = *std::max_element(x_, x_ + n_);
        low_y_ = *std::min_element(y_, y_ + n_), high_y_ = *std::max_element(y_, y_ + n_);
    }
    double low_x() const { return low_x_ - 1e-6; }
    double high_x() const { return high_x_ + 1e-6; }
    double low_y() const { return low_y_; }
    double high_y() const { return high_y_; }

    bool x_range(double ya, double yb, double& low, double& high) const {
        low = INFINITY, high = -INFINITY;
        for (int k = 0; k < n_; ++k) {
            const int next = k + 1 < n_ ? k + 1 : 0;
            double px = x_[k], py = y_[k], qx = x_[next], qy = y_[next];
            if (py > qy) std::swap(px, qx), std::swap(py, qy);
            if (qy < ya || py > yb) continue;
            const double slope = qy > py ? (qx - px) / (qy - py) : 0.0;
            const double x0 = py < ya ? px + slope * (ya - py) : px, x1 = qy > yb ? px + slope * (yb - py) : qx;
            low = std::min({low, x0, x1}), high = std::max({high, x0, x1});
        }
        low -= 1e-6, high += 1e-6;
        return low <= high;
    }

private:
    void clip(const ConvexRecord& r, int i) {
        double x[kCapacity], y[kCapacity];
        int m = 0;
        for (int k = 0; k < n_ && m + 2 <= kCapacity; ++k) {
            const int next = k + 1 < n_ ? k + 1 : 0;
            const double d0 = outside(r, i, x_[k], y_[k]), d1 = outside(r, i, x_[next], y_[next]);
            if (d0 <= 0) x[m] = x_[k], y[m] = y_[k], ++m;
            if ((d0 <= 0) != (d1 <= 0)) {
                const double s = d0 / (d0 - d1);
                x[m] = x_[k] + s * (x_[next] - x_[k]), y[m] = y_[k] + s * (y_[next] - y_[k]), ++m;
            }
        }
        n_ = m;
        std::copy(x, x + m, x_), std::copy(y, y + m, y_);
    }
    static double outside(const ConvexRecord& r, int i, double x, double y) {
        return r.A[i] * (x - r.x0) + r.B[i] * (y - r.y0) + r.C[i] - r.limit;
    }
    static constexpr int kCapacity = 32;  // a clip adds one corner at most; rounding on slivers might add more
    int n_ = 0;
    double x_[kCapacity], y_[kCapacity];
    double low_x_ = INFINITY, high_x_ = -INFINITY, low_y_ = INFINITY, high_y_ = -INFINITY;
};

}  // namespace e4dgs
