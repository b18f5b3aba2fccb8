// Propagates the sums of Gaussians back through projection and colour to the inputs, one thread per Gaussian. Features:
// SH_DEGREE (-1: colors), CAMERA, ANTIALIASED.
#include "camera_sum.cuh"
#include "inputs.cuh"
#include "records.cuh"
//
#include "gaussian.h"

using namespace e4dgs;

// sums, records: of each slot; see kGaussianSums. Gradients may be null; every row of the others is written. camera_rows [blocks, 16].
extern "C" __global__ void __launch_bounds__(kBackThreads)
    backproject_gaussians(const double* camera, int width, int height, int n, const float* means, const float* quats, const float* scales,
                          const float* opacities, const float* looks, const GaussianRecord* records, const int* slots, const uint8* visible, const float* sums, float* dmeans,
                          float* dquats, float* dscales, float* dopacities, float* dlooks, double* camera_rows) {
    const Camera<double>& cam = camera_of(camera, width, height);
    const int i = int(blockIdx.x * blockDim.x + threadIdx.x);
    const int slot = i < n && visible[i] ? slots[i] : -1;
    const bool blended = slot >= 0;
    if (i < n && !blended) {
        write_zeros(dmeans, i, 3), write_zeros(dquats, i, 4), write_zeros(dscales, i, 3), write_zeros(dopacities, i, 1);
        write_zeros(dlooks, i, kLooks);
    }
    CameraPart part = no_camera_part();
    if (blended) {
        const float *mean = means + 3 * int64(i), *quat = quats + 4 * int64(i), *scale = scales + 3 * int64(i), *sum = sums + kGaussianSums * int64(slot);
        GaussianView<double> view;
        project_gaussian<bool(ANTIALIASED)>(cam, mean, quat, scale, view);
        double moments[5], dmean2[2], dcov[3];
        for (int j = 0; j < 5; ++j) moments[j] = kLn2 * double(sum[5 + j]);  // alpha = 2^e
        moments_backward(records[slot].f, moments, dmean2, dcov);
        double dmean[3] = {0, 0, 0}, dquat[4] = {0, 0, 0, 0}, dscale[3] = {0, 0, 0};
        project_gaussian_backward<bool(ANTIALIASED)>(cam, view, mean, scale, dmean2, dcov, double(sum[3]), double(sum[4]), dmean, dquat, dscale, part);
        const double position[3] = {mean[0], mean[1], mean[2]};
        color_backward(cam, position, looks, i, sum, dlooks, dmean, part);
        for (int j = 0; dmeans && j < 3; ++j) dmeans[3 * int64(i) + j] = saturated(dmean[j]);
        for (int j = 0; dquats && j < 4; ++j) dquats[4 * int64(i) + j] = saturated(dquat[j]);
        for (int j = 0; dscales && j < 3; ++j) dscales[3 * int64(i) + j] = saturated(dscale[j]);
        if (dopacities) dopacities[i] = saturated(double(sum[4]) / double(opacities[i]));
    }
    add_camera_parts(part, camera_rows);
}
