// Converts convexes to records. A convex with a bad value is culled here and does not affect any other. Included by project.inl.

// Loads the points [K][3] of the convexes, and their means.
inline void load_points(const ConvexInput& in, const int64_t* index, Pack* points, Pack* centre) {
    const int K = in.points_each;
    load_rows(in.points, 3 * K, index, points);
    centre[0] = centre[1] = centre[2] = Pack(0);
    for (int k = 0; k < K; ++k)
        for (int j = 0; j < 3; ++j) centre[j] += points[3 * k + j] / Pack(K);
}

inline void mean_of(const Pack (*p)[3], int count, Pack* mean) {
    for (int j = 0; j < 3; ++j) {
        mean[j] = Pack(0);
        for (int k = 0; k < count; ++k) mean[j] += p[k][j] / Pack(count);
    }
}

// The bounding box of the polygon in which L_i <= limit for every edge. The normals (A, B) turn once around from edge to edge, so the
// extreme in a direction is bounded by the two edges whose normals enclose it. The box is never too small, and exact if both edges touch
// the polygon.
inline void polygon_box(const ConvexView<Pack>& v, const Pack* A, const Pack* B, const Pack* C, Pack limit, Pack x0, Pack y0, Pack& low_x,
                        Pack& high_x, Pack& low_y, Pack& high_y) {
    constexpr double kLoose = 1e-6;  // px
    for (int i = 0; i < v.slots; ++i) {
        const bool more = i + 1 < v.slots;
        const auto next = [&](const Pack* of) { return more ? choose(v.edge[i + 1], of[i + 1], of[0]) : of[0]; };
        const Pack Ai = A[i], Bi = B[i], Aj = next(A), Bj = next(B), none(0);
        const Pack det = Ai * Bj - Aj * Bi, ri = limit - C[i], rj = limit - next(C);
        const Truths meet = v.edge[i] & (det > none);
        const Pack x = x0 + (ri * Bj - rj * Bi) / det, y = y0 + (Ai * rj - Aj * ri) / det;  // where the two edges intersect
        high_x = choose(meet & (Bi <= none) & (Bj > none) & (x < high_x), x + Pack(kLoose), high_x);
        low_x = choose(meet & (Bi >= none) & (Bj < none) & (x > low_x), x - Pack(kLoose), low_x);
        high_y = choose(meet & (Ai >= none) & (Aj < none) & (y < high_y), y + Pack(kLoose), high_y);
        low_y = choose(meet & (Ai <= none) & (Aj > none) & (y > low_y), y - Pack(kLoose), low_y);
    }
}

template <bool AA>
void project_convex_lanes(const ProjectConvexes& job, const Camera<Pack>& camera, const int64_t* index, int count) {
    const SceneInput& scene = *job.scene;
    const ConvexInput& in = scene.convexes;
    const int K = in.points_each;
    Pack points[3 * kMaxPoints], centre[3], tau, kappa;
    load_points(in, index, points, centre);
    load_rows(in.tau, 1, index, &tau), load_rows(in.kappa, 1, index, &kappa);
    alignas(64) double lane[8][kLanes];
    for (int l = 0; l < kLanes; ++l) {
        constexpr float inverse = 1.0f / kMinAlpha;  // fainter convexes never reach kMinAlpha
        const float opacity = in.opacities[index[l]];
        lane[0][l] = double(opacity), lane[1][l] = opacity * inverse > 1.0f && opacity <= 1.0f ? double(inverse) * double(opacity) - 1.0 : 0.0;
        job.depth[index[l]] = __builtin_nan("");
    }
    Pack over = lanes_of(lane[1]);
    Truths good = bounded(points, 3 * K) & (tau > Pack(0)) & (tau <= Pack(kLargest)) & (kappa > Pack(0)) & (kappa <= Pack(kLargest)) & (over > Pack(0));
    if (none(good)) return;

    ConvexView<Pack> view;
    Pack c[3], A[kMaxPoints], B[kMaxPoints], C[kMaxPoints];
    good = good & project_convex<AA>(camera, points, K, view, [](ConvexView<Pack>& v, Truths those) { find_corners(v, those); });
    if (none(good)) return;
    if constexpr (AA) {
        mean_of(view.p, K, c);  // the centroid of the points before clipping may be behind the camera
        const Footprint<Pack> print = footprint(camera, area_of(view), view.perimeter, view.zc, kappa);
        kappa = print.kappa;
        const Pack opacity = lanes_of(lane[0]) * print.share * fade(view.zc, camera.near_z);
        over = opacity * Pack(double(1.0f / kMinAlpha)) - Pack(1);
        good = good & (over > Pack(0));
        if (none(good)) return;
        store_lanes(opacity, lane[0]);
        keep_off_camera(camera, centre);
    } else {
        to_camera(camera, centre, c);
    }
    const Pack x0 = camera.fx * c[0] / c[2] + camera.cx, y0 = camera.fy * c[1] / c[2] + camera.cy, rho = kappa / tau;
    edge_lines(camera, view, tau, x0, y0, A, B, C);
    // alpha >= kMinAlpha if tau S / ln 2 <= limit
    const Pack exact = log2(choose(good, over, Pack(1))) * tau / kappa, limit = exact + Pack(kSlack) + Pack(1e-5) * fabs(exact);
    Pack sum = limit + x0 + y0;
    for (int k = 0; k < view.slots; ++k) {
        A[k] = choose(view.edge[k], A[k], Pack(0)), B[k] = choose(view.edge[k], B[k], Pack(0)), C[k] = choose(view.edge[k], C[k], Pack(kNoEdge));
        sum += fabs(A[k]) + fabs(B[k]) + choose(view.edge[k], fabs(C[k]), Pack(0));
    }
    good = good & (fabs(sum) <= Pack(1e300)) & (rho <= Pack(kLargest)) & (fabs(limit) <= Pack(kLargest)) & (view.zc <= Pack(kLargest));
    Pack low_x = 0.5, low_y = 0.5, high_x = camera.width - 0.5, high_y = camera.height - 0.5;
    polygon_box(view, A, B, C, limit, x0, y0, low_x, high_x, low_y, high_y);
    low_x = larger(low_x, Pack(0.5)), high_x = smaller(high_x, Pack(camera.width - 0.5));
    low_y = larger(low_y, Pack(0.5)), high_y = smaller(high_y, Pack(camera.height - 0.5));
    good = good & (low_x <= high_x) & (low_y <= high_y);

    alignas(64) double line[3][kMaxPoints][kLanes];
    for (int k = 0; k < kMaxPoints; ++k) {
        const bool there = k < view.slots;
        store_lanes(there ? A[k] : Pack(0), line[0][k]), store_lanes(there ? B[k] : Pack(0), line[1][k]);
        store_lanes(there ? C[k] : Pack(kNoEdge), line[2][k]);
    }
    const Pack out[8] = {x0, y0, view.zc, limit, low_x, high_x, low_y, high_y};
    alignas(64) double opacities[kLanes], rhos[kLanes];
    for (int l = 0; l < kLanes; ++l) opacities[l] = lane[0][l];
    store_lanes(rho, rhos);
    for (int i = 0; i < 8; ++i) store_lanes(out[i], lane[i]);
    bool wanted[kLanes];
    for (int l = 0; l < kLanes; ++l) {
        TileBox& box = job.boxes[index[l]];
        wanted[l] = l < count && good.w[l] != 0 && tile_box(lane[4][l], lane[5][l], lane[6][l], lane[7][l], box) && drawn(scene, box) &&
                    usable(in, index[l], scene.extras);
    }
    float color[kLanes][3];
    colours(in, camera, centre, index, wanted, color);
    for (int l = 0; l < kLanes; ++l) {
        const int64_t i = index[l];
        if (!wanted[l]) continue;
        ConvexRecord& record = job.records[i];
        record.x0 = lane[0][l], record.y0 = lane[1][l];
        record.n = 0, record.points = uint16_t(K);
        for (int k = 0; k < K; ++k) {
            for (int j = 0; j < 3; ++j) record.lines[j * K + k] = line[j][k][l];
            record.n = uint16_t(record.n + (k < view.slots && view.edge[k].w[l] != 0));
        }
        record.opacity = float(opacities[l]), record.rho = float(rhos[l]), record.limit = float(lane[3][l]);
        for (int j = 0; j < 3; ++j) record.color[j] = color[l][j];
        record.z = float(lane[2][l]);
        job.depth[i] = lane[2][l];
    }
}

void project_convexes(const ProjectConvexes& job, int64_t first, int64_t last) {
    const Camera<Pack> camera = camera_of(job.scene->camera);
    for (int64_t at = first; at < last; at += kLanes) {
        int64_t index[kLanes];
        for (int l = 0; l < kLanes; ++l) index[l] = at + l < last ? at + l : at;
        (job.scene->antialiased ? project_convex_lanes<true> : project_convex_lanes<false>)(job, camera, index, last - at < kLanes ? int(last - at) : kLanes);
    }
}
