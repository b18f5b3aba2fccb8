// For each row of tiles, the tiles that a Gaussian's support may touch: the range of x that the ellipse u^2 + v^2 <= radius^2 covers
// within the row's pixel centres. Processes a vector of Gaussians at a time, row by row of their boxes. Included by project.inl.

inline void gaussian_spans_lanes(const SpanJob& job, const uint32_t* ids, int count) {
    alignas(64) double lane[8][kLanes];
    int rows = 0;
    for (int l = 0; l < kLanes; ++l) {
        const uint32_t id = ids[l < count ? l : 0];
        const GaussianRecord& r = job.records[id];
        const TileBox& box = job.boxes[id];
        lane[0][l] = r.x, lane[1][l] = r.y, lane[2][l] = r.f[0], lane[3][l] = r.f[1], lane[4][l] = r.f[2], lane[5][l] = double(r.radius);
        lane[6][l] = double(box.y0);
        if (l < count && box.y1 - box.y0 > rows) rows = box.y1 - box.y0;
    }
    const Pack x = lanes_of(lane[0]), y = lanes_of(lane[1]), f0 = lanes_of(lane[2]), f1 = lanes_of(lane[3]), f2 = lanes_of(lane[4]), radius = lanes_of(lane[5]);
    const Pack first_row = lanes_of(lane[6]), radius2 = radius * radius, inverse = Pack(1) / f0, high_y = radius / f2;
    const Pack rightmost = Pack(0) - high_y * f1 / sqrt(f1 * f1 + f2 * f2);  // y of the ellipse's right end, relative to the centre
    const auto within = [](Pack v, Pack low, Pack high) { return larger(smaller(v, high), low); };
    const auto half = [&](Pack dy) {
        const Pack v = f2 * dy;
        return sqrt(larger(radius2 - v * v, Pack(0)));
    };
    for (int row = 0; row < rows; ++row) {
        const Pack top = (first_row + Pack(row)) * Pack(kTile) + Pack(0.5), bottom = smaller(top + Pack(kTile - 1), Pack(job.height - 0.5));
        const Pack a = larger(top - y, Pack(0) - high_y), b = smaller(bottom - y, high_y);
        const Pack right = within(rightmost, a, b), left = within(Pack(0) - rightmost, a, b);
        const Pack low = larger(x + (Pack(0) - half(left) - f1 * left) * inverse, Pack(0.5));
        const Pack high = smaller(x + (half(right) - f1 * right) * inverse, Pack(job.width - 0.5));
        const Truths there = (a <= b) & (low <= high);
        store_lanes(choose(there, low, Pack(1)), lane[0]), store_lanes(choose(there, high, Pack(0)), lane[1]);
        for (int l = 0; l < count; ++l) {
            const TileBox& box = job.boxes[ids[l]];
            if (row >= box.y1 - box.y0) continue;
            Span& span = job.spans[job.begin[ids[l]] + uint32_t(row)];
            span = {0, 0};
            if (lane[0][l] > lane[1][l]) continue;
            int first = ceil_of((lane[0][l] - (kTile - 0.5)) / kTile), last = floor_of((lane[1][l] - 0.5) / kTile) + 1;
            if (first < box.x0) first = box.x0;
            if (last > box.x1) last = box.x1;
            if (first < last) span = {uint16_t(first), uint16_t(last)};
        }
    }
}

void gaussian_spans(const SpanJob& job, const uint32_t* ids, int64_t count) {
    for (int64_t at = 0; at < count; at += kLanes) gaussian_spans_lanes(job, ids + at, int(count - at < kLanes ? count - at : kLanes));
}
