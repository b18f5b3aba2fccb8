// Counts (pixel, primitive) pairs: plain scalar code in double, slow, and independent of the kernels that it judges. Image rows are
// counted apart; in each, primitives come front to back and cover an interval of pixels.
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

namespace {

struct Rules {
    double least, most, stop;  // alpha that is skipped, alpha's cap, transmittance at which a pixel stops
};

struct Interval {
    double low = -INFINITY, high = INFINITY;  // px
};

// alpha = opacity exp(-(a dx^2 + 2 b dx dy + c dy^2) / 2)
struct Gaussian {
    double x, y, a, b, c, opacity;

    Interval interval(double py, const Rules& rules) const {
        const double dy = py - y, reach = 2 * std::log(opacity / rules.least);
        const double root = b * b * dy * dy - a * (c * dy * dy - reach);
        if (!(root >= 0)) return {0, -1};
        return {x + (-b * dy - std::sqrt(root)) / a, x + (-b * dy + std::sqrt(root)) / a};
    }

    double alpha(double px, double py) const {
        const double dx = px - x, dy = py - y;
        return opacity * std::exp(-0.5 * (a * dx * dx + 2 * b * dx * dy + c * dy * dy));
    }
};

// alpha = opacity / (1 + exp(rho ln sum_i exp(L_i))), L_i = A_i px + B_i py + C_i; C_i is -infinity where there is no edge.
struct Convex {
    const double* values;  // opacity, rho, A B C of each edge
    int edges;

    double line(int i, double px, double py) const { return values[2 + 3 * i] * px + values[3 + 3 * i] * py + values[4 + 3 * i]; }

    Interval interval(double py, const Rules& rules) const {
        const double over = values[0] / rules.least - 1, limit = std::log(over) / values[1];
        if (!(over > 0)) return {0, -1};
        Interval found;
        for (int i = 0; i < edges; ++i) {
            const double A = values[2 + 3 * i], at = (limit - line(i, 0, py)) / A;
            if (A > 0) found.high = std::min(found.high, at);
            if (A < 0) found.low = std::max(found.low, at);
        }
        return found;
    }

    double alpha(double px, double py) const {
        double top = -INFINITY, sum = 0;
        for (int i = 0; i < edges; ++i) top = std::max(top, line(i, px, py));
        for (int i = 0; i < edges; ++i) sum += std::exp(line(i, px, py) - top);
        return values[0] / (1 + std::exp(values[1] * (top + std::log(sum))));
    }
};

struct Row {
    double y;
    const Rules& rules;
    std::vector<double> transmittance;
    int64_t visible = 0, blended = 0;

    template <class Primitive>
    void add(const Primitive& primitive) {
        const Interval in = primitive.interval(y, rules);
        const double width = double(transmittance.size());
        const double low = std::max(std::floor(in.low) - 1, 0.0), high = std::min(std::ceil(in.high) + 1, width);  // alpha itself decides
        for (double x = low; x < high; ++x) {
            const double alpha = std::min(primitive.alpha(x + 0.5, y), rules.most);
            if (alpha < rules.least) continue;
            double& t = transmittance[size_t(x)];
            t *= 1 - alpha;
            ++visible, blended += t >= rules.stop;
        }
    }
};

}  // namespace

// order [n + m]: Gaussians 0..n-1 and convexes n..n+m-1 front to back. rules [3] and gaussians [n, 6] as in the structs above, convexes
// [m, 2 + 3 edges]. counts [2]: pairs with alpha of at least rules.least, and those in front of their pixel's stop.
extern "C" void count_pairs(int width, int height, const double* rules, int64_t n, const double* gaussians, int64_t m, const double* convexes,
                            int edges, const int64_t* order, int threads, int64_t* counts) {
    const Rules all{rules[0], rules[1], rules[2]};
    int64_t visible = 0, blended = 0;
#pragma omp parallel for schedule(dynamic) num_threads(threads) reduction(+ : visible, blended)
    for (int y = 0; y < height; ++y) {
        Row row{y + 0.5, all, std::vector<double>(size_t(width), 1.0)};
        for (int64_t k = 0; k < n + m; ++k) {
            const int64_t id = order[k];
            if (id < n) {
                const double* g = gaussians + 6 * id;
                row.add(Gaussian{g[0], g[1], g[2], g[3], g[4], g[5]});
            } else {
                row.add(Convex{convexes + (2 + 3 * edges) * (id - n), edges});
            }
        }
        visible += row.visible, blended += row.blended;
    }
    counts[0] = visible, counts[1] = blended;
}
