// The hulls of a vector of convexes at once. With points sorted from left to right, a point is a corner of the lower hull if it lies below
// every line from a point on its left to a point on its right; likewise for the upper hull. If points are collinear or coincide, only that
// convex goes through the scan of hull.h. Included by project.inl.

constexpr double kClearTurn = 4 * kFlatTurn;  // relative to the squared extent; if all turns are larger, the scan finds the same corners

struct LanePlane {
    const Pack *px, *py;
    int lane;
    double x(int i) const { return px[i].v[lane]; }
    double y(int i) const { return py[i].v[lane]; }
};

// Bits that mark the sorted points on the lower hull from left to right, then those on the upper hull from right to left. unsure: lanes
// that need the scan.
inline Words hull_path(const ConvexView<Pack>& v, Words* order, Words& unsure) {
    const int n = v.points;
    Pack x[kMaxPoints], y[kMaxPoints], low_y = v.y[0], high_y = v.y[0];
    for (int i = 0; i < n; ++i) {
        x[i] = v.x[i], y[i] = v.y[i], order[i] = Words{} + i;
        low_y = smaller(low_y, y[i]), high_y = larger(high_y, y[i]);
    }
    for (int round = 0; round < n; ++round)
        for (int i = round % 2; i + 1 < n; i += 2) {
            const Truths swap = x[i] > x[i + 1];
            const Pack a = x[i], b = y[i];
            const Words c = order[i];
            x[i] = choose(swap, x[i + 1], a), x[i + 1] = choose(swap, a, x[i + 1]);
            y[i] = choose(swap, y[i + 1], b), y[i + 1] = choose(swap, b, y[i + 1]);
            order[i] = swap.w ? order[i + 1] : c, order[i + 1] = swap.w ? c : order[i + 1];
        }
    const Pack extent = larger(x[n - 1] - x[0], high_y - low_y), clear = Pack(kClearTurn) * extent * extent;
    Truths lower[kMaxPoints], upper[kMaxPoints], sure = clear >= Pack(0);
    for (int i = 0; i < n; ++i) lower[i] = upper[i] = sure;
    // Points with the same x have no order from left to right.
    for (int i = 0; i + 1 < n; ++i) sure = sure & (x[i + 1] - x[i] > Pack(kClearTurn) * extent);
    for (int i = 0; i < n; ++i)
        for (int j = i + 1; j < n; ++j) {
            const Pack dx = x[j] - x[i], dy = y[j] - y[i];
            for (int k = j + 1; k < n; ++k) {
                const Pack t = dx * (y[k] - y[i]) - dy * (x[k] - x[i]);
                sure = sure & (fabs(t) > clear);
                lower[j] = lower[j] & (t > Pack(0)), upper[j] = upper[j] & (t < Pack(0));
            }
        }
    unsure = ~sure.w;
    Words path = Words{} + (1 | 1 << (n - 1));
    for (int j = 1; j + 1 < n; ++j) path |= (lower[j].w & (int64_t(1) << j)) | (upper[j].w & (int64_t(1) << (2 * n - 2 - j)));
    return path;
}

inline void find_corners(ConvexView<Pack>& v, Truths good) {
    const int n = v.points;
    Words order[kMaxPoints], unsure, path = hull_path(v, order, unsure);
    alignas(64) double edges[kLanes];
    v.slots = 0;
    for (int l = 0; l < kLanes; ++l) {
        int corner[kMaxPoints], count = 0;
        if (good.w[l] && unsure[l]) {
            count = hull_corners(LanePlane{v.x, v.y, l}, n, corner);
        } else if (good.w[l]) {
            for (uint32_t left = uint32_t(path[l]); left; left &= left - 1) {
                const int at = __builtin_ctz(left);
                corner[count++] = int(order[at < n ? at : 2 * n - 2 - at][l]);
            }
        }
        edges[l] = double(count);
        for (int k = 0; k <= kMaxPoints; ++k) v.corner[k].at[l] = k < count ? corner[k] : count ? corner[0] : 0;
        if (count > v.slots) v.slots = count;
    }
    for (int k = 0; k < v.slots; ++k) v.edge[k] = lanes_of(edges) > Pack(k);
}
