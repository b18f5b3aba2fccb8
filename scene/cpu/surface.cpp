#include "surface.h"

#include <algorithm>
#include <cmath>
#include <vector>

#include "clones.h"
#include "exp.h"

namespace e4dgs {
namespace {

constexpr float kCovered = 0.5f, kNearest = 1e-3f;  // as in depth_smoothness.py
constexpr float kEdge = 0.02f, kUsualWidth = 320.0f;
constexpr float kLargest = 0.2f;  // as in measured_depth.py

// inverse [W] and solid [W] (1 or 0) of one row.
E4DGS_CLONES void inverse_row(const float* __restrict depth, const float* __restrict alpha, int n, float unit, float* __restrict inverse, float* __restrict solid) {
    const float nearest = kNearest * unit;
    for (int x = 0; x < n; ++x) {
        inverse[x] = unit * std::max(alpha[x], kCovered) / std::max(depth[x], nearest);
        solid[x] = (alpha[x] > kCovered) & (depth[x] > nearest) ? 1.0f : 0.0f;
    }
}

// difference [n]: the largest change of a channel between pixels a and b, each 3 n floats.
E4DGS_CLONES void colour_row(const float* __restrict a, const float* __restrict b, int n, float* __restrict difference) {
    for (int x = 0; x < n; ++x) {
        const float red = std::fabs(a[3 * x] - b[3 * x]), green = std::fabs(a[3 * x + 1] - b[3 * x + 1]), blue = std::fabs(a[3 * x + 2] - b[3 * x + 2]);
        difference[x] = std::max(red, std::max(green, blue));
    }
}

// For n triples of pixels a, b, c in line: bend = |a - 2 b + c| times its weight; slope: the derivative with respect to a and c.
E4DGS_CLONES void bend_row(const float* __restrict a, const float* __restrict b, const float* __restrict c, const float* __restrict solid_a,
                           const float* __restrict solid_b, const float* __restrict solid_c, const float* __restrict before,
                           const float* __restrict after, int n, float* __restrict bend, float* __restrict slope) {
    for (int x = 0; x < n; ++x) {
        const float second = a[x] - 2 * b[x] + c[x];
        const float weight = solid_a[x] * solid_b[x] * solid_c[x] * exp_of(-std::max(before[x], after[x]) / kEdge);
        bend[x] = std::fabs(second) * weight;
        slope[x] = second != 0 ? std::copysign(weight, second) : 0.0f;
    }
}

// Adds the derivative of the bends of one direction: slope at the triples around the pixels before, at and after.
E4DGS_CLONES void gather_row(const float* __restrict before, const float* __restrict here, const float* __restrict after, int n, float scale, float* __restrict to) {
    for (int x = 0; x < n; ++x) to[x] += scale * (before[x] - 2 * here[x] + after[x]);
}

E4DGS_CLONES double measured_row(const float* __restrict inverse, const float* __restrict solid, const float* __restrict measured,
                                 const float* __restrict counts, int n, float unit, float scale, float* __restrict to) {
    double sum = 0;
    for (int x = 0; x < n; ++x) {
        const float there = measured[x] > 0 ? solid[x] * counts[x] : 0.0f, off = inverse[x] - unit * measured[x], size = std::fabs(off);
        sum += double(there * std::min(size, kLargest));
        to[x] += (size <= kLargest) & (off != 0) ? std::copysign(there * scale, off) : 0.0f;
    }
    return sum;
}

E4DGS_CLONES void chain_row(const float* __restrict g, const float* __restrict depth, const float* __restrict inverse, const float* __restrict solid,
                            const float* __restrict weight, int n, float unit, float* __restrict d_depth, float* __restrict d_alpha) {
    for (int x = 0; x < n; ++x) {
        const float along = (weight ? g[x] * weight[x] : g[x]) * solid[x], z = std::max(depth[x], kNearest * unit);
        d_depth[x] = -along * inverse[x] / z;
        d_alpha[x] = along * unit / z;
    }
}

double sum_of(const float* row, int n) {
    double sum = 0;
    for (int x = 0; x < n; ++x) sum += double(row[x]);
    return sum;
}

}  // namespace

double surface(const SurfaceInput& in, float* d_depth, float* d_alpha, int threads) {
    const int h = in.height, w = in.width, stride = w + 2;
    const size_t pixels = size_t(h) * w, padded = size_t(h + 2) * stride;
    const bool across = in.smooth > 0 && w > 2, down = in.smooth > 0 && h > 2;
    const float widths = float(w) / kUsualWidth;
    const double many_across = double(h) * std::max(w - 2, 1), many_down = double(std::max(h - 2, 1)) * w;
    std::vector<float> inverse(pixels), solid(pixels);
    std::vector<float> slopes_x(across ? padded : 0, 0.0f), slopes_y(down ? padded : 0, 0.0f);  // with a border of zeros
    std::vector<double> sums(h, 0.0);
    const auto at = [&](int y) { return size_t(y) * w; };
    const auto border = [&](std::vector<float>& of, int y) { return of.data() + size_t(y + 1) * stride + 1; };
#pragma omp parallel for num_threads(threads) schedule(static)
    for (int y = 0; y < h; ++y) inverse_row(in.depth + at(y), in.alpha + at(y), w, in.unit, inverse.data() + at(y), solid.data() + at(y));
#pragma omp parallel for num_threads(threads) schedule(static)
    for (int y = 0; y < h; ++y) {
        std::vector<float> before(w), after(w), bend(w);
        const float *v = inverse.data() + at(y), *s = solid.data() + at(y), *image = in.image + 3 * at(y);
        if (across) {
            colour_row(image, image + 3, w - 1, before.data());
            bend_row(v, v + 1, v + 2, s, s + 1, s + 2, before.data(), before.data() + 1, w - 2, bend.data(), border(slopes_x, y) + 1);
            sums[y] += sum_of(bend.data(), w - 2) * double(in.smooth * widths) / many_across;
        }
        if (down && y > 0 && y < h - 1) {
            colour_row(image - 3 * w, image, w, before.data()), colour_row(image, image + 3 * w, w, after.data());
            bend_row(v - w, v, v + w, s - w, s, s + w, before.data(), after.data(), w, bend.data(), border(slopes_y, y));
            sums[y] += sum_of(bend.data(), w) * double(in.smooth * widths) / many_down;
        }
    }
#pragma omp parallel for num_threads(threads) schedule(static)
    for (int y = 0; y < h; ++y) {
        std::vector<float> g(w, 0.0f), counts(w, 1.0f);
        if (across) {
            const float* slope = border(slopes_x, y);
            gather_row(slope - 1, slope, slope + 1, w, float(in.smooth * widths / many_across), g.data());
        }
        if (down) gather_row(border(slopes_y, y - 1), border(slopes_y, y), border(slopes_y, y + 1), w, float(in.smooth * widths / many_down), g.data());
        if (in.measured) {
            if (in.moving) {  // the nearest pixel, as torch's interpolate chooses it
                const int row = std::min(int(std::floor(float(y) * (float(in.moving_height) / float(h)))), in.moving_height - 1);
                const float step = float(in.moving_width) / float(w);
                for (int x = 0; x < w; ++x)
                    counts[x] = in.moving[size_t(row) * in.moving_width + std::min(int(std::floor(float(x) * step)), in.moving_width - 1)] ? 0.0f : 1.0f;
            }
            sums[y] += measured_row(inverse.data() + at(y), solid.data() + at(y), in.measured + at(y), counts.data(), w, in.unit,
                                    float(in.measure / double(pixels)), g.data()) * double(in.measure) / double(pixels);
        }
        chain_row(g.data(), in.depth + at(y), inverse.data() + at(y), solid.data() + at(y), in.weight ? in.weight + at(y) : nullptr, w, in.unit,
                  d_depth + at(y), d_alpha + at(y));
    }
    double total = 0;
    for (double sum : sums) total += sum;
    return total;
}

}  // namespace e4dgs
