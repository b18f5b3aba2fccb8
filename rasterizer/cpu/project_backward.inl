// A Gaussian's slots are summed in the order of its tiles, in double; then the sums go back through projection and colour to the
// inputs, a vector of Gaussians at a time. Rows that no tile touched become zero. Included by project.inl.

inline void zero_row(const BackprojectJob& job, int64_t i) {
    const GaussianGrad& out = job.out;
    const SceneInput& scene = *job.scene;
    const int sh = (scene.gaussians.degree + 1) * (scene.gaussians.degree + 1) * 3;
    const auto clear = [i](float* to, int width) {
        if (to) __builtin_memset(to + i * width, 0, sizeof(float) * size_t(width));
    };
    clear(out.means, 3), clear(out.quats, 4), clear(out.scales, 3), clear(out.opacities, 1);
    clear(out.colors, 3), clear(out.sh, sh), clear(out.extras, scene.extras);
}

constexpr int kSums = 12;  // ten are used; a slot has room for twelve

inline bool sum_slots(const BackprojectJob& job, int64_t i, double* sums) {
    bool any = false;
    for (int c = 0; c < kSums; ++c) sums[c] = 0.0;
    for (uint64_t s = job.slot_begin[i]; s < job.slot_begin[i + 1]; s += job.units) {
        if (!job.touched[s]) continue;
        any = true;
        for (int c = 0; c < kSums; ++c) sums[c] += double(job.slots[4 * s + uint64_t(c)]);
    }
    if (!any || !job.out.extras) return any;
    const int extras = job.scene->extras;
    for (int e = 0; e < extras; ++e) {
        double total = 0.0;
        for (uint64_t s = job.slot_begin[i]; job.extras && s < job.slot_begin[i + 1]; s += job.units)
            if (job.touched[s]) total += double(job.slots[4 * s + 10 + uint64_t(e)]);
        job.out.extras[i * extras + e] = float(total);
    }
    return true;
}

template <class G>
void colours_backward(const BackprojectJob& job, const Camera<Pack>& camera, const Pack* position, const int64_t* index, const bool* mine,
                      const double (*dcolour)[kLanes], Pack* dposition, G& grad) {
    const GaussianInput& in = job.scene->gaussians;
    if (in.colors) {
        for (int l = 0; job.out.colors && l < kLanes; ++l)
            for (int c = 0; mine[l] && c < 3; ++c) job.out.colors[3 * index[l] + c] = float(dcolour[c][l]);
        return;
    }
    float* sh = job.out.sh;
    switch (in.degree) {
        case 0: return sh_colours_backward<0>(camera, position, in.sh, index, mine, dcolour, sh, dposition, grad);
        case 1: return sh_colours_backward<1>(camera, position, in.sh, index, mine, dcolour, sh, dposition, grad);
        case 2: return sh_colours_backward<2>(camera, position, in.sh, index, mine, dcolour, sh, dposition, grad);
        default: return sh_colours_backward<3>(camera, position, in.sh, index, mine, dcolour, sh, dposition, grad);
    }
}

// sums [kSums][lanes]: colour 3, z, then the moments. Lanes that are not `mine` repeat another row, with sums of zero.
template <class G>
void backproject_lanes(const BackprojectJob& job, const Camera<Pack>& camera, const int64_t* index, const bool* mine, double (*sums)[kLanes], G& grad) {
    const GaussianInput& in = job.scene->gaussians;
    const GaussianGrad& out = job.out;
    Pack mean[3], quat[4], scale[3];
    load_rows<3>(in.means, index, mean), load_rows<4>(in.quats, index, quat), load_rows<3>(in.scales, index, scale);
    GaussianView<Pack> view;
    project_gaussian(camera, mean, quat, scale, view);
    Pack f[3], moments[5], dmean2[2], dcov[3];
    alignas(64) double lane[10][kLanes];
    for (int l = 0; l < kLanes; ++l)
        for (int j = 0; j < 3; ++j) lane[j][l] = job.records[index[l]].f[j];
    for (int j = 0; j < 3; ++j) f[j] = *reinterpret_cast<const Doubles*>(lane[j]);
    for (int j = 0; j < 5; ++j) moments[j] = Pack(*reinterpret_cast<const Doubles*>(sums[5 + j])) * Pack(kLn2);  // alpha = 2^e
    moments_backward(f, moments, dmean2, dcov);
    Pack dmean[3] = {0, 0, 0}, dquat[4] = {0, 0, 0, 0}, dscale[3] = {0, 0, 0};
    project_gaussian_backward(camera, view, mean, scale, dmean2, dcov, Pack(*reinterpret_cast<const Doubles*>(sums[3])), dmean, dquat, dscale, grad);
    colours_backward(job, camera, mean, index, mine, sums, dmean, grad);

    const auto write = [&](float* to, const Pack* from, int width) {
        if (!to) return;
        // Beyond float32's range (scales at its very end) a gradient is its largest number, not an infinity.
        for (int j = 0; j < width; ++j) store_lanes(larger(smaller(from[j], Pack(kLargest)), Pack(-kLargest)), lane[j]);
        for (int l = 0; l < kLanes; ++l)
            for (int j = 0; mine[l] && j < width; ++j) to[index[l] * width + j] = float(lane[j][l]);
    };
    write(out.means, dmean, 3), write(out.quats, dquat, 4), write(out.scales, dscale, 3);
    for (int l = 0; out.opacities && l < kLanes; ++l)
        if (mine[l]) out.opacities[index[l]] = float(sums[4][l] / double(in.opacities[index[l]]));
}

// A Gaussian's lane depends on its own number alone: what happens to others must not change a bit, also of the camera's gradient.
template <class G>
void backproject(const BackprojectJob& job, int64_t first, int64_t last, G& grad) {
    const Camera<Pack> camera = camera_of(job.scene->camera);
    for (int64_t at = first; at < last; at += kLanes) {
        int64_t index[kLanes], touched = -1;
        alignas(64) double sums[kSums][kLanes], one[kSums];
        bool mine[kLanes];
        for (int l = 0; l < kLanes; ++l) {
            mine[l] = at + l < last && sum_slots(job, at + l, one);
            if (at + l < last && !mine[l]) zero_row(job, at + l);
            if (mine[l]) touched = at + l;
            index[l] = at + l;
            for (int c = 0; c < kSums; ++c) sums[c][l] = mine[l] ? one[c] : 0.0;
        }
        if (touched < 0) continue;
        for (int l = 0; l < kLanes; ++l)
            if (!mine[l]) index[l] = touched;  // good values, with a gradient of zero
        backproject_lanes(job, camera, index, mine, sums, grad);
    }
}

inline double sum_of_lanes(Pack a) {
    double sum = 0.0;
    for (int l = 0; l < kLanes; ++l) sum += a.v[l];
    return sum;
}

void backproject_block(const BackprojectJob& job, int64_t first, int64_t last, double* camera) {
    if (!camera) {
        NoCameraGrad nothing;
        return backproject(job, first, last, nothing);
    }
    CameraGrad<Pack> grad;
    grad.fx = grad.fy = grad.cx = grad.cy = Pack(0);
    for (Pack& r : grad.R) r = Pack(0);
    for (Pack& t : grad.t) t = Pack(0);
    backproject(job, first, last, grad);
    camera[0] = sum_of_lanes(grad.fx), camera[1] = sum_of_lanes(grad.fy), camera[2] = sum_of_lanes(grad.cx), camera[3] = sum_of_lanes(grad.cy);
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) camera[4 + 4 * i + j] = sum_of_lanes(grad.R[3 * i + j]);
        camera[4 + 4 * i + 3] = sum_of_lanes(grad.t[i]);
    }
}
