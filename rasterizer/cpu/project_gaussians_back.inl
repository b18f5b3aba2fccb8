// Propagates the sums of Gaussians back through projection and colour to the inputs. Included by project.inl.

template <bool AA>
struct GaussianRows {
    static constexpr int kMost = kSlotShape + kGaussianShape;  // colour 3, z, then the moments

    static int shape(const BackprojectGaussians&, int64_t) { return kMost; }

    static void zero(const BackprojectGaussians& job, int64_t i) {
        clear_row(job.out.means, i, 3), clear_row(job.out.quats, i, 4), clear_row(job.out.scales, i, 3);
        zero_looks(job.scene->gaussians, job.out, job.scene->extras, i);
    }

    template <class G>
    static void lanes(const BackprojectGaussians& job, const Camera<Pack>& camera, const int64_t* index, const bool* mine, double (*sums)[kLanes], G& grad) {
        const GaussianInput& in = job.scene->gaussians;
        const GaussianGrad& out = job.out;
        Pack mean[3], quat[4], scale[3];
        load_rows(in.means, 3, index, mean), load_rows(in.quats, 4, index, quat), load_rows(in.scales, 3, index, scale);
        GaussianView<Pack> view;
        project_gaussian<AA>(camera, mean, quat, scale, view);
        Pack f[3], moments[5], dmean2[2], dcov[3];
        alignas(64) double lane[10][kLanes];
        for (int l = 0; l < kLanes; ++l)
            for (int j = 0; j < 3; ++j) lane[j][l] = job.records[index[l]].f[j];
        for (int j = 0; j < 3; ++j) f[j] = lanes_of(lane[j]);
        for (int j = 0; j < 5; ++j) moments[j] = lanes_of(sums[5 + j]) * Pack(kLn2);  // alpha = 2^e
        moments_backward(f, moments, dmean2, dcov);
        Pack dmean[3] = {0, 0, 0}, dquat[4] = {0, 0, 0, 0}, dscale[3] = {0, 0, 0};
        project_gaussian_backward<AA>(camera, view, mean, scale, dmean2, dcov, lanes_of(sums[3]), lanes_of(sums[4]), dmean, dquat, dscale, grad);
        colours_backward(in, out, camera, mean, index, mine, sums, dmean, grad);

        const auto write = [&](float* to, const Pack* from, int width) { write_rows(to, from, width, index, mine); };
        write(out.means, dmean, 3), write(out.quats, dquat, 4), write(out.scales, dscale, 3);
        for (int l = 0; out.opacities && l < kLanes; ++l)
            if (mine[l]) out.opacities[index[l]] = float(sums[4][l] / double(in.opacities[index[l]]));
    }
};

void backproject_gaussians(const BackprojectGaussians& job, int64_t first, int64_t last, double* camera) {
    with_camera_grad(camera, [&](auto& grad) {
        job.scene->antialiased ? backproject<GaussianRows<true>>(job, first, last, grad) : backproject<GaussianRows<false>>(job, first, last, grad);
    });
}
