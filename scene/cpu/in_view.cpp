#include "in_view.h"

#include <algorithm>
#include <cmath>
#include <optional>
#include <vector>

#include "clones.h"
#include "exp.h"

namespace e4dgs {
namespace {

constexpr int64_t kBlock = 256;        // Gaussians that are processed together
constexpr float kFaintest = 255.0f;    // the rasterizer leaves out what is fainter than 1 / 255
constexpr float kSlack = 1.001f;       // so that rounding never leaves out what the rasterizer shows
constexpr double kReach = 3.3305;      // sqrt(2 ln 255), and a little more: standard deviations at which an opaque Gaussian is that faint
constexpr double kDilation = 0.3;      // px^2, the larger of the two modes
constexpr double kMargin = 0.3;        // of half the image: so far outside, the rasterizer clamps x/z and y/z
constexpr double kRounding = 1e-6;     // of a mean's coordinates, for float arithmetic elsewhere
constexpr double kPixels = 0.01;       // px, the same for projections

struct Block {
    float mean[3][kBlock];
    float scale[kBlock];               // largest of the three, world units
    float faint[kBlock];               // one over the opacity
    bool kept[kBlock];
    double low[2][kBlock], high[2][kBlock];  // px
};

// Where the Gaussians are at the moment, and how faint.
E4DGS_CLONES void present(const ViewedGaussians& in, int64_t first, int64_t count, Block& to) {
    const float* __restrict means = in.means + 3 * first;
    const float* __restrict logs = in.log_scales + 3 * first;
    const float* __restrict logits = in.opacity_logits + first;
    for (int64_t i = 0; i < count; ++i) {
        const float a = logs[3 * i], b = logs[3 * i + 1], c = logs[3 * i + 2], largest = a > b ? a : b;
        to.scale[i] = exp_of(largest > c ? largest : c);
    }
    for (int64_t i = 0; i < count; ++i) to.mean[0][i] = means[3 * i], to.mean[1][i] = means[3 * i + 1], to.mean[2][i] = means[3 * i + 2];
    for (int64_t i = 0; i < count; ++i) to.faint[i] = 1 + exp_of(-logits[i]);
    if (!in.times) return;
    const float* __restrict times = in.times + first;
    const float* __restrict spans = in.log_spans + first;
    const float* __restrict velocities = in.velocities + 3 * first;
    const bool* __restrict dynamic = in.dynamic + first;
    float age[kBlock];
    for (int64_t i = 0; i < count; ++i) {
        const float since = in.frame - times[i];  // loaded for the others, too: a loop without branches is vectorised
        age[i] = dynamic[i] ? since : 0.0f;
    }
    for (int64_t i = 0; i < count; ++i) {
        const float z = age[i] * exp_of(-spans[i]);
        to.faint[i] *= exp_of(0.5f * z * z);
    }
    for (int64_t i = 0; i < count; ++i) {
        to.mean[0][i] += age[i] * velocities[3 * i], to.mean[1][i] += age[i] * velocities[3 * i + 1], to.mean[2][i] += age[i] * velocities[3 * i + 2];
    }
}

// The pixels that they can reach. The covariance's eigenvalues are at most the square of the largest scale.
E4DGS_CLONES void reached(const Seeing& view, int64_t count, float faintest, Block& to) {
    const double* p = view.pose;
    const double margin_x = 0.5 * kMargin * view.width / view.fx, margin_y = 0.5 * kMargin * view.height / view.fy;
    const double least_x = -view.cx / view.fx - margin_x, most_x = (view.width - view.cx) / view.fx + margin_x;
    const double least_y = -view.cy / view.fy - margin_y, most_y = (view.height - view.cy) / view.fy + margin_y;
    for (int64_t i = 0; i < count; ++i) {
        const double a = double(to.mean[0][i]), b = double(to.mean[1][i]), c = double(to.mean[2][i]), scale = double(to.scale[i]);
        const double rounding = kRounding * (std::fabs(a) + std::fabs(b) + std::fabs(c));
        const double x = p[0] * a + p[1] * b + p[2] * c + p[3], y = p[4] * a + p[5] * b + p[6] * c + p[7], z = p[8] * a + p[9] * b + p[10] * c + p[11];
        const double depth = std::max(z - rounding, view.near), slope_x = x / depth, slope_y = y / depth;
        const double used_x = std::min(std::max(slope_x, least_x), most_x), used_y = std::min(std::max(slope_y, least_y), most_y);
        const double per_x = view.fx / depth, per_y = view.fy / depth;
        const double reach_x = kReach * std::sqrt(scale * scale * per_x * per_x * (1 + used_x * used_x) + kDilation);
        const double reach_y = kReach * std::sqrt(scale * scale * per_y * per_y * (1 + used_y * used_y) + kDilation);
        const double off_x = kPixels + 2 * rounding * per_x * (1 + std::fabs(slope_x)), off_y = kPixels + 2 * rounding * per_y * (1 + std::fabs(slope_y));
        const double u = view.fx * slope_x + view.cx, v = view.fy * slope_y + view.cy;
        to.low[0][i] = u - reach_x - off_x, to.high[0][i] = u + reach_x + off_x;
        to.low[1][i] = v - reach_y - off_y, to.high[1][i] = v + reach_y + off_y;
        const bool inside = (z + rounding >= view.near) & (to.high[0][i] >= 0.5) & (to.low[0][i] <= view.width - 0.5) & (to.high[1][i] >= 0.5) &
                            (to.low[1][i] <= view.height - 0.5);
        to.kept[i] = (to.faint[i] <= faintest) & inside;  // false for a NaN, which the rasterizer leaves out, too
    }
}

// Whether anything is drawn in a range of tiles, from sums over all tiles above and to the left.
class DrawnTiles {
public:
    explicit DrawnTiles(const Seeing& view) : view_(view), sums_(size_t(view.rows + 1) * (view.columns + 1), 0) {
        for (int y = 0; y < view.rows; ++y)
            for (int x = 0; x < view.columns; ++x) at(y + 1, x + 1) = at(y, x + 1) + at(y + 1, x) - at(y, x) + view.tiles[y * view.columns + x];
    }

    bool any(const Block& of, int64_t i) const {
        const int x0 = tile(of.low[0][i], view_.columns), x1 = tile(of.high[0][i], view_.columns) + 1;
        const int y0 = tile(of.low[1][i], view_.rows), y1 = tile(of.high[1][i], view_.rows) + 1;
        return at(y1, x1) - at(y0, x1) - at(y1, x0) + at(y0, x0) > 0;
    }

private:
    const Seeing& view_;
    std::vector<int> sums_;

    int& at(int y, int x) { return sums_[size_t(y) * (view_.columns + 1) + x]; }
    int at(int y, int x) const { return sums_[size_t(y) * (view_.columns + 1) + x]; }
    int tile(double pixel, int count) const { return int(std::min(std::max(pixel / view_.tile, 0.0), double(count - 1))); }
};

}  // namespace

int64_t in_view(const ViewedGaussians& in, const Seeing& view, int64_t* index, int threads) {
    const int64_t blocks = (in.n + kBlock - 1) / kBlock;
    std::vector<int64_t> begin(blocks + 1, 0);
    std::optional<DrawnTiles> drawn;
    if (view.tiles) drawn.emplace(view);
#pragma omp parallel for num_threads(threads) schedule(static)
    for (int64_t b = 0; b < blocks; ++b) {
        Block block;
        const int64_t first = b * kBlock, count = std::min(kBlock, in.n - first);
        present(in, first, count, block);
        reached(view, count, kFaintest * kSlack * in.fuller, block);
        int64_t found = 0;  // to the front of the block's own part of `index`
        for (int64_t i = 0; i < count; ++i)
            if (block.kept[i] && (!drawn || drawn->any(block, i))) index[first + found++] = first + i;
        begin[b + 1] = found;
    }
    for (int64_t b = 0; b < blocks; ++b) {
        std::copy_n(index + b * kBlock, begin[b + 1], index + begin[b]);
        begin[b + 1] += begin[b];
    }
    return begin[blocks];
}

}  // namespace e4dgs
