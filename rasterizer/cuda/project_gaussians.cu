// Converts Gaussians to records, one thread per Gaussian: cull, project, colour. Those that are left are stored without gaps. A
// Gaussian with a bad value is culled here and does not affect any other. Features: SH_DEGREE (-1: colors), ANTIALIASED.
#include "inputs.cuh"
#include "kept.cuh"
//
#include "gaussian.h"

namespace e4dgs {

struct GaussianInputs {
    const float *means, *quats, *scales, *opacities, *looks, *extras;
    int channels;
};

__device__ inline bool project(const GaussianInputs& in, const Camera<double>& cam, int64 i, GaussianRecord& record, TileBox& box,
                               double& depth) {
    const float *mean = in.means + 3 * i, *quat = in.quats + 4 * i, *scale = in.scales + 3 * i, opacity = in.opacities[i];
    bool good = opacity >= kMinAlpha && opacity <= 1.0f;  // fainter Gaussians never reach kMinAlpha
    for (int j = 0; j < 3; ++j) good = good && is_finite(mean[j]) && is_finite(scale[j]) && scale[j] > 0.0f;
    for (int j = 0; j < 4; ++j) good = good && is_finite(quat[j]);
    GaussianView<double> view;
    if (!good || !project_gaussian<bool(ANTIALIASED)>(cam, mean, quat, scale, view)) return false;

    double f[3];
    exponent_factor(view, f);
#if ANTIALIASED
    double k[3];
    const double near = view.p[2] < 2 * cam.near_z ? fade(view.p[2], cam.near_z) : 1.0, share2 = dilation_share2(view, k) * near * near;
    if (!(share2 >= double(kMinAlpha) * double(kMinAlpha))) return false;  // alpha never reaches kMinAlpha
    const float exponent = log2f(opacity) + 0.5f * log2f(float(share2));
    if (!(exponent >= float(kLog2MinAlpha))) return false;
#else
    const float exponent = log2f(opacity);
#endif
    // In float, as what follows only has to contain the support; rounding is far below kSlack and the factor 1.00001.
    const float radius2 = exponent + float(kSlack - kLog2MinAlpha), reach = radius2 * float(2 / kLog2E);
    const double rx = sqrtf(reach * float(view.cov[0])) * 1.00001f, ry = sqrtf(reach * float(view.cov[2])) * 1.00001f;
    const double x = view.mean[0], y = view.mean[1], z = view.p[2];
    const double low_x = larger(x - rx, 0.5), high_x = smaller(x + rx, cam.width - 0.5);
    const double low_y = larger(y - ry, 0.5), high_y = smaller(y + ry, cam.height - 0.5);
    good = view.det <= 1e300 && view.cov[0] + view.cov[2] <= 1e300 && is_bounded(z) && fabs(x) <= 1e300 && fabs(y) <= 1e300;
    if (!(good && low_x <= high_x && low_y <= high_y)) return false;
    if (!usable_looks(in.looks, in.extras, in.channels, i) || !tile_box(low_x, high_x, low_y, high_y, box)) return false;

    depth = z;
    record.x = x, record.y = y, record.z = float(z);
    for (int j = 0; j < 3; ++j) record.f[j] = f[j];
    record.exponent = exponent, record.radius = sqrtf(radius2) * 1.00001f;
    const double position[3] = {mean[0], mean[1], mean[2]};
    color_of(cam, position, in.looks, i, record.color);
    return true;
}

}  // namespace e4dgs

using namespace e4dgs;

// Blocks that should fit on a multiprocessor at once. Without SH, the compiler left to itself (0) spills a few registers to fit a sixth one.
constexpr int kFitting = SH_DEGREE > 0 ? 0 : 5;

// See `Slots`. records [room].
extern "C" __global__ void __launch_bounds__(kProjectThreads, kFitting)
    project_gaussians(const double* camera, int width, int height, int n, const float* means, const float* quats, const float* scales,
                      const float* opacities, const float* looks, const float* extras, int channels, int room, uint64* workspace, int64* counts, int* slots,
                      int* ids, double* depth, TileBox* boxes, uint8* visible, GaussianRecord* records) {
    const Slots all = {n, room, workspace, slots, ids, depth, boxes, visible};
    const int64 block = all.take_block(), i = block * kProjectThreads + threadIdx.x;
    const Camera<double>& cam = camera_of(camera, width, height);
    const GaussianInputs in = {means, quats, scales, opacities, looks, extras, channels};
    GaussianRecord record;
    TileBox box;
    double z;
    const bool there = i < n && project(in, cam, i, record, box, z);
    int64 seen;
    const int slot = all.take(block, i, 0, there, box, z, seen);
    if (slot >= 0) records[slot] = record;
    if (all.ends(block)) {
        counts[kSeenGaussians] = seen;
        counts[kKeptGaussians] = counts[kKept] = seen < room ? seen : room;
    }
}
