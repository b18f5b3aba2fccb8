#include "patch_match.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "clones.h"
#include "exp.h"

namespace e4dgs {
namespace {

constexpr int kRadius = 3;                // px, half of the window
constexpr int kSamples = 25;              // every second pixel of the window, like the fields of one colour of a chess board
constexpr int kPadded = 32;               // a whole number of vectors
constexpr float kColour = 40.0f;          // grey levels; pixels that differ more are probably on another surface
constexpr float kLeastSpread = 1.0f;      // grey levels; with less texture nothing is compared
constexpr float kUseful = 0.3f;           // neighbours with a lower score have nothing to offer
constexpr float kFirstRange = 0.02f;      // of the range of inverse depth: the first random steps,
constexpr float kFirstSlant = 1.5f;       // and of the slant at which depth changes by itself over one focal length
constexpr float kSmaller = 0.3f;          // factor on the last random step
constexpr float kAlike = 0.02f;           // steps; planes that differ less over the window are not tried
constexpr float kAhead = 1e-6f;           // least depth in the other image
constexpr int kOffsets[8][2] = {{-1, 0}, {1, 0}, {0, -1}, {0, 1}, {-5, 0}, {5, 0}, {0, -5}, {0, 5}};  // always to the other colour

struct Window {
    float x[kPadded], y[kPadded];  // px from the centre
};

constexpr Window make_window() {
    Window window{};
    int k = 0;
    for (int y = -kRadius; y <= kRadius; ++y)
        for (int x = -kRadius; x <= kRadius; ++x)
            if (((x + y) & 1) == 0) window.x[k] = float(x), window.y[k] = float(y), ++k;
    return window;
}
constexpr Window kWindow = make_window();

// The patch around a pixel. weight: 0 outside the image, sums to 1. centred: weight times the difference from the mean.
struct Patch {
    float weight[kPadded], centred[kPadded];
    float spread;
};

E4DGS_CLONES void take_patch(const Patches& in, int x, int y, Patch& patch) {
    float value[kPadded], total = 0, mean = 0, variance = 0;
    const float centre = in.image[int64_t(y) * in.width + x];
    for (int k = 0; k < kPadded; ++k) {
        const int px = x + int(kWindow.x[k]), py = y + int(kWindow.y[k]);
        const int cx = std::min(std::max(px, 0), in.width - 1), cy = std::min(std::max(py, 0), in.height - 1);
        value[k] = in.image[int64_t(cy) * in.width + cx];
        patch.weight[k] = k < kSamples && cx == px && cy == py ? 1.0f : 0.0f;
    }
    for (int k = 0; k < kPadded; ++k) {
        const float far = (kWindow.x[k] * kWindow.x[k] + kWindow.y[k] * kWindow.y[k]) / (2 * kRadius * kRadius);
        const float change = (value[k] - centre) / kColour;
        patch.weight[k] *= exp_of(-0.5f * change * change - far);
    }
#pragma omp simd reduction(+ : total, mean)
    for (int k = 0; k < kPadded; ++k) total += patch.weight[k], mean += patch.weight[k] * value[k];
    mean /= total;
#pragma omp simd reduction(+ : variance)
    for (int k = 0; k < kPadded; ++k) {
        patch.weight[k] /= total;
        patch.centred[k] = patch.weight[k] * (value[k] - mean);
        variance += patch.centred[k] * (value[k] - mean);
    }
    patch.spread = std::sqrt(variance);
}

struct Plane {
    float inverse, dx, dy;
};

// Correlation of the patch around (x, y) with image j, if the surface there is `plane`; -1 where image j does not show it.
E4DGS_CLONES float correlate(const Patches& in, int j, const Patch& patch, float x, float y, const Plane& plane) {
    const float* to = in.to + 12 * j;
    const float* __restrict image = in.others + int64_t(j) * in.height * in.width;
    float at[3], dx[3], dy[3];
    for (int i = 0; i < 3; ++i) {
        dx[i] = to[4 * i] + to[4 * i + 3] * plane.dx, dy[i] = to[4 * i + 1] + to[4 * i + 3] * plane.dy;
        at[i] = to[4 * i] * x + to[4 * i + 1] * y + to[4 * i + 2] + to[4 * i + 3] * plane.inverse;
    }
    if (!(at[2] > kAhead)) return -1;
    const float u0 = at[0] / at[2], v0 = at[1] / at[2];
    if (!(u0 >= 0 && u0 < float(in.width) && v0 >= 0 && v0 < float(in.height))) return -1;
    const float right = float(in.width) - 1.001f, bottom = float(in.height) - 1.001f;
    const int stride = in.width;
    int place[kPadded];
    float a[kPadded], b[kPadded], value[kPadded];
    for (int k = 0; k < kPadded; ++k) {
        const float z = std::max(at[2] + dx[2] * kWindow.x[k] + dy[2] * kWindow.y[k], kAhead), w = 1 / z;
        float u = (at[0] + dx[0] * kWindow.x[k] + dy[0] * kWindow.y[k]) * w - 0.5f;
        float v = (at[1] + dx[1] * kWindow.x[k] + dy[1] * kWindow.y[k]) * w - 0.5f;
        u = u > 0 ? u : 0.0f, v = v > 0 ? v : 0.0f;
        u = u < right ? u : right, v = v < bottom ? v : bottom;
        const int column = int(u), row = int(v);
        a[k] = u - float(column), b[k] = v - float(row), place[k] = row * stride + column;
    }
    for (int k = 0; k < kPadded; ++k) {
        const float top = image[place[k]] + a[k] * (image[place[k] + 1] - image[place[k]]);
        const float under = image[place[k] + stride] + a[k] * (image[place[k] + stride + 1] - image[place[k] + stride]);
        value[k] = top + b[k] * (under - top);
    }
    float mean = 0, both = 0, variance = 0;
#pragma omp simd reduction(+ : mean, both)
    for (int k = 0; k < kPadded; ++k) mean += patch.weight[k] * value[k], both += patch.centred[k] * value[k];
#pragma omp simd reduction(+ : variance)
    for (int k = 0; k < kPadded; ++k) variance += patch.weight[k] * (value[k] - mean) * (value[k] - mean);
    const float spread = std::sqrt(variance);
    return spread < kLeastSpread ? -1.0f : both / (std::max(patch.spread, kLeastSpread) * spread);
}

float agreement(const Patches& in, const Patch& patch, int x, int y, const Plane& plane) {
    std::array<float, kMostOthers> each;
    for (int j = 0; j < in.count; ++j) each[size_t(j)] = correlate(in, j, patch, float(x) + 0.5f, float(y) + 0.5f, plane);
    const int used = std::min(in.best, in.count);
    float total = 0;
    for (int i = 0; i < used; ++i) {
        const auto top = std::max_element(each.begin(), each.begin() + in.count);
        total += *top, *top = -2.0f;
    }
    return total / float(used);
}

// Random numbers in (-1, 1) that depend on the pixel and the iteration alone.
class Random {
public:
    explicit Random(uint32_t seed) : state_(seed) {}
    float operator()() {
        state_ += 0x9e3779b9U;  // of "lowbias32", a mixer by C. Wellons
        uint32_t x = state_;
        x = (x ^ (x >> 16)) * 0x7feb352dU, x = (x ^ (x >> 15)) * 0x846ca68bU, x ^= x >> 16;
        return float(x >> 8) * (2.0f / 16777216.0f) - 1.0f;
    }

private:
    uint32_t state_;
};

// One pixel of one iteration: the planes of its neighbours, then random changes of the best.
void improve(const Patches& in, int iteration, int x, int y, float* planes, float* score) {
    Patch patch;
    const int64_t pixels = int64_t(in.height) * in.width, here = int64_t(y) * in.width + x;
    if (in.wanted && !in.wanted[here]) return;
    take_patch(in, x, y, patch);
    if (patch.spread < kLeastSpread) return;
    Plane best{planes[here], planes[pixels + here], planes[2 * pixels + here]};
    float most = score[here];
    auto attempt = [&](const Plane& plane) {
        if (!(plane.inverse >= in.low && plane.inverse <= in.high)) return;
        const float found = agreement(in, patch, x, y, plane);
        if (found > most) most = found, best = plane;
    };
    for (const auto& [dx, dy] : kOffsets) {
        if (x + dx < 0 || x + dx >= in.width || y + dy < 0 || y + dy >= in.height) continue;
        const int64_t there = here + int64_t(dy) * in.width + dx;
        if (score[there] < kUseful) continue;
        Plane plane{planes[there], planes[pixels + there], planes[2 * pixels + there]};
        plane.inverse -= plane.dx * float(dx) + plane.dy * float(dy);
        const float change = std::fabs(plane.inverse - best.inverse) + kRadius * (std::fabs(plane.dx - best.dx) + std::fabs(plane.dy - best.dy));
        if (change > kAlike * in.step) attempt(plane);
    }
    Random random(uint32_t(here) * 2654435761U + uint32_t(iteration) * 40503U);
    const float smaller = std::ldexp(1.0f, -iteration), range = kFirstRange * smaller * (in.high - in.low);
    const float slant = kFirstSlant * smaller * best.inverse / in.focal;
    const float deeper = best.inverse + range * random();
    attempt({deeper, best.dx, best.dy});
    const float dx = slant * random(), dy = slant * random();
    attempt({best.inverse, best.dx + dx, best.dy + dy});
    const float all[3] = {kSmaller * range * random(), kSmaller * slant * random(), kSmaller * slant * random()};
    attempt({best.inverse + all[0], best.dx + all[1], best.dy + all[2]});
    planes[here] = best.inverse, planes[pixels + here] = best.dx, planes[2 * pixels + here] = best.dy;
    score[here] = most;
}

}  // namespace

void patch_match(const Patches& in, int iterations, float* planes, float* score, int threads) {
    const int64_t pixels = int64_t(in.height) * in.width;
#pragma omp parallel for num_threads(threads) schedule(dynamic, 4)
    for (int y = 0; y < in.height; ++y)
        for (int x = 0; x < in.width; ++x) {
            const int64_t here = int64_t(y) * in.width + x;
            score[here] = -1;
            if (in.wanted && !in.wanted[here]) continue;
            Patch patch;
            take_patch(in, x, y, patch);
            score[here] = patch.spread < kLeastSpread ? -1.0f : agreement(in, patch, x, y, {planes[here], planes[pixels + here], planes[2 * pixels + here]});
        }
    // Pixels of one colour of a chess board read only those of the other.
    for (int pass = 0; pass < 2 * iterations; ++pass)
#pragma omp parallel for num_threads(threads) schedule(dynamic, 4)
        for (int y = 0; y < in.height; ++y)
            for (int x = (y + pass) & 1; x < in.width; x += 2) improve(in, pass / 2, x, y, planes, score);
}

}  // namespace e4dgs
