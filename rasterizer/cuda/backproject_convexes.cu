// Propagates the sums of convexes back through hull, projection and colour to the inputs, one thread per convex. Features:
// POINTS, SH_DEGREE (-1: colors), CAMERA, ANTIALIASED.
#include "camera_sum.cuh"
#include "convex_hull.cuh"
#include "inputs.cuh"
#include "records.cuh"

using namespace e4dgs;

// sums, records: of each slot; see kConvexSums. Gradients may be null; every row of the others is written. camera_rows [blocks, 16].
extern "C" __global__ void __launch_bounds__(kBackThreads, 2)
    backproject_convexes(const double* camera, int width, int height, int n, const float* points, const float* taus, const float* kappas,
                         const float* opacities, const float* looks, const ConvexRecord* records, const int* slots, const uint8* visible, const float* sums, float* dpoints,
                         float* dtaus, float* dkappas, float* dopacities, float* dlooks, double* camera_rows) {
    const Camera<double>& cam = camera_of(camera, width, height);
    const int i = int(blockIdx.x * blockDim.x + threadIdx.x);
    const int slot = i < n && visible[i] ? slots[i] : -1;
    const bool blended = slot >= 0;
    if (i < n && !blended) {
        write_zeros(dpoints, i, 3 * POINTS), write_zeros(dtaus, i, 1), write_zeros(dkappas, i, 1), write_zeros(dopacities, i, 1);
        write_zeros(dlooks, i, kLooks);
    }
    CameraPart part = no_camera_part();
    if (blended) {
        const float *corners = points + 3 * POINTS * int64(i), *sum = sums + kConvexSums * int64(slot);
        ConvexView<double> view;
        see_convex(cam, corners, view);
        const double tau = taus[i], drho = -kLn2 * sum[5];  // E = 2^(rho lse), alpha = opacity / (1 + E)
        double kappa = kappas[i], dz = sum[3], darea = 0.0, dperimeter = 0.0;
#if ANTIALIASED
        const double area = area_of(view), g = sum[4];
        const Footprint<double> print = footprint(cam, area, view.perimeter, view.zc, kappa);
        double dsharp;
        footprint_backward(cam, print, area, view.perimeter, view.zc, kappa, g, drho / tau, dsharp, darea, dperimeter, dz, part);
        dz += g * fade_slope(view.zc, cam.near_z);
        kappa = print.kappa;
#endif
        const double rho = kappa / tau;
        double gA[kMaxPoints], gB[kMaxPoints], gC[kMaxPoints], out[3 * POINTS], dtau = 0.0, dkappa = 0.0, centre[3], dcentre[3] = {0, 0, 0};
        for (int e = 0; e < view.slots; ++e) {
            const float* edge = sum + kConvexEdges + 3 * e;
            gA[e] = -kLn2 * rho * edge[0], gB[e] = -kLn2 * rho * edge[1], gC[e] = -kLn2 * rho * edge[2];
        }
        for (double& d : out) d = 0.0;
        project_convex_backward<bool(ANTIALIASED)>(cam, view, corners, tau, kappa, records[slot].x0, records[slot].y0, gA, gB, gC, drho, -kLn2 * sum[6], dz,
                                                   darea, dperimeter, out, dtau, dkappa, part);
#if ANTIALIASED
        dkappa = dsharp;
#endif
        centroid_of(corners, centre);
#if ANTIALIASED
        keep_off_camera(cam, centre);
#endif
        color_backward(cam, centre, looks, i, sum, dlooks, dcentre, part);
        for (int j = 0; dpoints && j < 3 * POINTS; ++j) dpoints[3 * POINTS * int64(i) + j] = saturated(out[j] + dcentre[j % 3] / POINTS);
        if (dtaus) dtaus[i] = saturated(dtau);
        if (dkappas) dkappas[i] = saturated(dkappa);
        if (dopacities) dopacities[i] = saturated(double(sum[4]) / double(opacities[i]));
    }
    add_camera_parts(part, camera_rows);
}
