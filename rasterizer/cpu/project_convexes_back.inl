// Propagates the sums of convexes back through hull, projection and colour to the inputs. Included by project.inl.

template <bool AA>
struct ConvexRows {
    static constexpr int kMost = kConvexEdges + 3 * kMaxPoints;

    static int shape(const BackprojectConvexes& job, int64_t i) {
        // The record of a culled convex may be empty.
        return job.slot_begin[i] < job.slot_begin[i + 1] ? kConvexEdges + 3 * job.records[i].n : 0;
    }

    static void zero(const BackprojectConvexes& job, int64_t i) {
        const ConvexInput& in = job.scene->convexes;
        clear_row(job.out.points, i, 3 * in.points_each), clear_row(job.out.tau, i, 1), clear_row(job.out.kappa, i, 1);
        zero_looks(in, job.out, job.scene->extras, i);
    }

    // sums: see kConvexEdges.
    template <class G>
    static void lanes(const BackprojectConvexes& job, const Camera<Pack>& camera, const int64_t* index, const bool* mine, double (*sums)[kLanes], G& grad) {
        const ConvexInput& in = job.scene->convexes;
        const ConvexGrad& out = job.out;
        const int K = in.points_each;
        Pack points[3 * kMaxPoints], centre[3], tau, kappa;
        load_points(in, index, points, centre);
        load_rows(in.tau, 1, index, &tau), load_rows(in.kappa, 1, index, &kappa);
        ConvexView<Pack> view;
        project_convex<AA>(camera, points, K, view, [](ConvexView<Pack>& v, Truths those) { find_corners(v, those); });
        alignas(64) double at[2][kLanes];
        for (int l = 0; l < kLanes; ++l) at[0][l] = job.records[index[l]].x0, at[1][l] = job.records[index[l]].y0;

        const Pack ln2 = kLn2, drho = -ln2 * lanes_of(sums[5]);  // E = 2^(rho lse), alpha = opacity / (1 + E)
        Pack dz = lanes_of(sums[3]), darea = 0, dperimeter = 0, dsharp = 0;
        if constexpr (AA) {
            const Pack area = area_of(view), g = lanes_of(sums[4]);
            const Footprint<Pack> print = footprint(camera, area, view.perimeter, view.zc, kappa);
            footprint_backward(camera, print, area, view.perimeter, view.zc, kappa, g, drho / tau, dsharp, darea, dperimeter, dz, grad);
            dz += g * fade_slope(view.zc, camera.near_z);
            kappa = print.kappa;
            keep_off_camera(camera, centre);
        }
        Pack gA[kMaxPoints], gB[kMaxPoints], gC[kMaxPoints], dpoints[3 * kMaxPoints], dtau = 0, dkappa = 0, dcentre[3] = {0, 0, 0};
        const Pack rho = kappa / tau;
        for (int e = 0; e < view.slots; ++e) {
            const double(*edge)[kLanes] = sums + kConvexEdges + 3 * e;
            gA[e] = -ln2 * rho * lanes_of(edge[0]), gB[e] = -ln2 * rho * lanes_of(edge[1]), gC[e] = -ln2 * rho * lanes_of(edge[2]);
        }
        for (int i = 0; i < 3 * K; ++i) dpoints[i] = Pack(0);
        project_convex_backward<AA>(camera, view, points, tau, kappa, lanes_of(at[0]), lanes_of(at[1]), gA, gB, gC, drho, -ln2 * lanes_of(sums[6]), dz,
                                    darea, dperimeter, dpoints, dtau, dkappa, grad);
        if constexpr (AA) dkappa = dsharp;
        colours_backward(in, out, camera, centre, index, mine, sums, dcentre, grad);
        for (int i = 0; i < 3 * K; ++i) dpoints[i] += dcentre[i % 3] / Pack(K);

        write_rows(out.points, dpoints, 3 * K, index, mine);
        write_rows(out.tau, &dtau, 1, index, mine), write_rows(out.kappa, &dkappa, 1, index, mine);
        for (int l = 0; out.opacities && l < kLanes; ++l)
            if (mine[l]) out.opacities[index[l]] = float(sums[4][l] / double(in.opacities[index[l]]));
    }
};

void backproject_convexes(const BackprojectConvexes& job, int64_t first, int64_t last, double* camera) {
    with_camera_grad(camera, [&](auto& grad) {
        job.scene->antialiased ? backproject<ConvexRows<true>>(job, first, last, grad) : backproject<ConvexRows<false>>(job, first, last, grad);
    });
}
