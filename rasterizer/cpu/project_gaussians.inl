// Converts Gaussians to records. A Gaussian with a bad value is culled here and does not affect any other. Included by project.inl.

// logs: log2 of the opacities; meaningless if an opacity is bad.
template <bool AA>
void project_lanes(const ProjectGaussians& job, const Camera<Pack>& camera, const int64_t* index, int count, const float* logs) {
    const SceneInput& scene = *job.scene;
    const GaussianInput& in = scene.gaussians;
    Pack mean[3], quat[4], scale[3], opacity;
    load_rows(in.means, 3, index, mean), load_rows(in.quats, 4, index, quat), load_rows(in.scales, 3, index, scale);
    load_rows(in.opacities, 1, index, &opacity);
    Truths good = bounded(mean, 3) & bounded(quat, 4) & bounded(scale, 3);
    for (int j = 0; j < 3; ++j) good = good & (scale[j] > Pack(0));
    good = good & (opacity >= Pack(double(kMinAlpha))) & (opacity <= Pack(1));  // fainter Gaussians never reach kMinAlpha
    for (int l = 0; l < kLanes; ++l) job.depth[index[l]] = __builtin_nan("");
    if (none(good)) return;

    GaussianView<Pack> view;
    good = good & project_gaussian<AA>(camera, mean, quat, scale, view);
    Pack f[3], exponent;
    alignas(64) double lane[12][kLanes];
    for (int l = 0; l < kLanes; ++l) lane[0][l] = double(logs[l]);
    exponent = *reinterpret_cast<const Doubles*>(lane[0]);
    if constexpr (AA) {
        Pack k[3];
        const Pack near = fade(view.p[2], camera.near_z), share2 = dilation_share2(view, k) * near * near;
        const Truths there = share2 >= Pack(double(kMinAlpha) * double(kMinAlpha));  // else alpha never reaches kMinAlpha
        exponent += choose(there, Pack(0.5) * log2(choose(there, share2, Pack(1))), Pack(0));
        good = good & there & (exponent >= Pack(kLog2MinAlpha));
    }
    exponent_factor(view, f);
    const Pack radius2 = exponent + Pack(kSlack - kLog2MinAlpha), reach = radius2 * Pack(2 / kLog2E);
    const Pack rx = sqrt(reach * view.cov[0]) * Pack(1.00001), ry = sqrt(reach * view.cov[2]) * Pack(1.00001);
    const Pack x = view.mean[0], y = view.mean[1], z = view.p[2];
    const Pack low_x = larger(x - rx, Pack(0.5)), high_x = smaller(x + rx, Pack(camera.width - 0.5));
    const Pack low_y = larger(y - ry, Pack(0.5)), high_y = smaller(y + ry, Pack(camera.height - 0.5));
    good = good & (view.det <= Pack(1e300)) & (view.cov[0] + view.cov[2] <= Pack(1e300)) & (z <= Pack(kLargest));
    good = good & (fabs(x) <= Pack(1e300)) & (fabs(y) <= Pack(1e300)) & (low_x <= high_x) & (low_y <= high_y);
    if (none(good)) return;

    const Pack radius = sqrt(radius2) * Pack(1.00001);
    const Pack out[12] = {x, y, f[0], f[1], f[2], radius, z, low_x, high_x, low_y, high_y, exponent};
    bool wanted[kLanes];
    for (int i = 0; i < 12; ++i) store_lanes(out[i], lane[i]);
    for (int l = 0; l < kLanes; ++l) {
        TileBox& box = job.boxes[index[l]];
        wanted[l] = l < count && good.w[l] != 0 && tile_box(lane[7][l], lane[8][l], lane[9][l], lane[10][l], box) && drawn(scene, box) &&
                    usable(in, index[l], scene.extras);
    }
    float color[kLanes][3];
    colours(in, camera, mean, index, wanted, color);
    for (int l = 0; l < kLanes; ++l) {
        if (!wanted[l]) continue;
        const int64_t i = index[l];
        GaussianRecord& record = job.records[i];
        record.x = lane[0][l], record.y = lane[1][l];
        for (int j = 0; j < 3; ++j) record.f[j] = lane[2 + j][l], record.color[j] = color[l][j];
        record.exponent = float(lane[11][l]), record.radius = float(lane[5][l]), record.z = float(lane[6][l]);
        job.depth[i] = lane[6][l];
    }
}

void project_gaussians(const ProjectGaussians& job, int64_t first, int64_t last) {
    const Camera<Pack> camera = camera_of(job.scene->camera);
    alignas(64) float logs[kProjectBlock];
    const int n = int(last - first);
    for (int i = 0; i < kProjectBlock; ++i) logs[i] = i < n ? job.scene->gaussians.opacities[first + i] : 1.0f;
    for (int i = 0; i < kProjectBlock; i += kWidth) store(logs + i, log2(max(load(logs + i), set1(1e-30f))));
    for (int at = 0; at < n; at += kLanes) {
        int64_t index[kLanes];
        for (int l = 0; l < kLanes; ++l) index[l] = first + (at + l < n ? at + l : at);
        (job.scene->antialiased ? project_lanes<true> : project_lanes<false>)(job, camera, index, n - at < kLanes ? n - at : kLanes, logs + at);
    }
}
