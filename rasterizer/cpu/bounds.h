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

// The polygon L_i <= limit for every edge. Normals (A, B) turn once around from edge to edge, so the extreme in a direction is bounded
// by the two edges whose normals enclose it: never too small, and exact where both touch the polygon.
class ConvexBounds {
public:
    ConvexBounds(const ConvexRecord& r, int width, int height) : r_(r), low_x_(0.5), low_y_(0.5), high_x_(width - 0.5), high_y_(height - 0.5) {
        double low_x = low_x_, low_y = low_y_, high_x = high_x_, high_y = high_y_;
        for (int i = 0; i < r.n; ++i) {
            const int j = i + 1 < r.n ? i + 1 : 0;
            const double Ai = r.A[i], Bi = r.B[i], Aj = r.A[j], Bj = r.B[j], det = Ai * Bj - Aj * Bi;
            const bool right = Bi <= 0 && Bj > 0, left = Bi >= 0 && Bj < 0, down = Ai >= 0 && Aj < 0, up = Ai <= 0 && Aj > 0;
            if (!(right || left || down || up) || !(det > 0)) continue;
            const double ri = r.limit - r.C[i], rj = r.limit - r.C[j];
            const double x = r.x0 + (ri * Bj - rj * Bi) / det, y = r.y0 + (Ai * rj - Aj * ri) / det;  // where the two meet
            if (right && x < high_x) high_x = x;
            if (left && x > low_x) low_x = x;
            if (down && y < high_y) high_y = y;
            if (up && y > low_y) low_y = y;
        }
        low_x_ = low_x, low_y_ = low_y, high_x_ = high_x, high_y_ = high_y;
    }
    double low_x() const { return low_x_ - kLoose; }
    double high_x() const { return high_x_ + kLoose; }
    double low_y() const { return low_y_ - kLoose; }
    double high_y() const { return high_y_ + kLoose; }

    // x range over the rows ya..yb, each edge for itself: a little larger than the polygon where a corner lies between them.
    bool x_range(double ya, double yb, double& low, double& high) const {
        low = low_x_, high = high_x_;
        for (int i = 0; i < r_.n; ++i) {
            const double A = r_.A[i];
            if (A == 0) continue;
            const double base = r_.limit - r_.C[i], a = (base - r_.B[i] * (ya - r_.y0)) / A, b = (base - r_.B[i] * (yb - r_.y0)) / A;
            if (A > 0)
                high = std::min(high, r_.x0 + std::max(a, b));
            else
                low = std::max(low, r_.x0 + std::min(a, b));
        }
        low -= kLoose, high += kLoose;
        return low <= high;
    }

private:
    static constexpr double kLoose = 1e-6;  // px
    const ConvexRecord& r_;
    double low_x_, low_y_, high_x_, high_y_;
};

}  // namespace e4dgs
