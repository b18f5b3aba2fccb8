// Converts convexes to records, one thread per convex: cull, project, hull, colour. Those that are left are stored without gaps. A
// convex with a bad value is culled here and does not affect any other. Features: POINTS, SH_DEGREE (-1: colors), ANTIALIASED.
#include "convex_hull.cuh"
#include "inputs.cuh"
#include "kept.cuh"

namespace e4dgs {

struct ConvexInputs {
    const float *points, *tau, *kappa, *opacities, *looks, *extras;
    int channels;
};

// The bounding box of the polygon in which L_i <= limit for every edge. The normals (A, B) turn once around from edge to edge, so the
// extreme in a direction is bounded by the two edges whose normals enclose it. The box is never too small, and exact if both edges touch
// the polygon.
__device__ inline void polygon_box(int n, const double* A, const double* B, const double* C, double limit, double x0, double y0, double* low, double* high) {
    constexpr double loose = 1e-6;  // px
    for (int i = 0; i < n; ++i) {
        const int j = i + 1 < n ? i + 1 : 0;
        const double det = A[i] * B[j] - A[j] * B[i], ri = limit - C[i], rj = limit - C[j];
        if (!(det > 0.0)) continue;
        const double x = x0 + (ri * B[j] - rj * B[i]) / det, y = y0 + (A[i] * rj - A[j] * ri) / det;  // where the two edges intersect
        if (B[i] <= 0.0 && B[j] > 0.0 && x < high[0]) high[0] = x + loose;
        if (B[i] >= 0.0 && B[j] < 0.0 && x > low[0]) low[0] = x - loose;
        if (A[i] >= 0.0 && A[j] < 0.0 && y < high[1]) high[1] = y + loose;
        if (A[i] <= 0.0 && A[j] > 0.0 && y > low[1]) low[1] = y - loose;
    }
}

__device__ inline bool project(const ConvexInputs& in, const Camera<double>& cam, int64 i, ConvexRecord& record, TileBox& box, double& depth) {
    const float* points = in.points + 3 * POINTS * i;
    float opacity = in.opacities[i];
    const double tau = in.tau[i];
    double kappa = in.kappa[i];
    constexpr float inverse = 1.0f / kMinAlpha;  // fainter convexes never reach kMinAlpha
    bool good = opacity * inverse > 1.0f && opacity <= 1.0f && tau > 0.0 && is_bounded(tau) && kappa > 0.0 && is_bounded(kappa);
    for (int j = 0; j < 3 * POINTS; ++j) good = good && is_finite(points[j]);
    ConvexView<double> view;
    if (!good || !see_convex(cam, points, view)) return false;

    double centre[3], c[3], A[kMaxPoints], B[kMaxPoints], C[kMaxPoints];
    centroid_of(points, centre);
#if ANTIALIASED
    mean_of(view.p, c);  // the centroid of the points before clipping may be behind the camera
    const Footprint<double> print = footprint(cam, area_of(view), view.perimeter, view.zc, kappa);
    kappa = print.kappa;
    const double shown = double(opacity) * print.share * fade(view.zc, cam.near_z), over = shown * double(inverse) - 1.0;
    if (!(over > 0.0)) return false;
    opacity = float(shown);
    keep_off_camera(cam, centre);
#else
    to_camera(cam, centre, c);
    const double over = double(inverse) * double(opacity) - 1.0;
#endif
    const double x0 = cam.fx * c[0] / c[2] + cam.cx, y0 = cam.fy * c[1] / c[2] + cam.cy, rho = kappa / tau;
    edge_lines(cam, view, tau, x0, y0, A, B, C);
    // alpha >= kMinAlpha if tau S / ln 2 <= limit
    const double exact = log2(over) * tau / kappa, limit = exact + kSlack + 1e-5 * fabs(exact);
    double sum = limit + x0 + y0;
    for (int k = 0; k < view.slots; ++k) sum += fabs(A[k]) + fabs(B[k]) + fabs(C[k]);
    if (!(fabs(sum) <= 1e300 && is_bounded(rho) && is_bounded(limit) && is_bounded(view.zc))) return false;
    double low[2] = {0.5, 0.5}, high[2] = {cam.width - 0.5, cam.height - 0.5};
    polygon_box(view.slots, A, B, C, limit, x0, y0, low, high);
    for (int j = 0; j < 2; ++j) low[j] = larger(low[j], 0.5), high[j] = smaller(high[j], (j ? cam.height : cam.width) - 0.5);
    if (!(low[0] <= high[0] && low[1] <= high[1])) return false;
    if (!usable_looks(in.looks, in.extras, in.channels, i) || !tile_box(low[0], high[0], low[1], high[1], box)) return false;

    depth = view.zc;
    record.x0 = x0, record.y0 = y0, record.n = view.slots;
    for (int k = 0; k < POINTS; ++k) {
        const bool there = k < view.slots;
        record.line[k][0] = there ? A[k] : 0.0, record.line[k][1] = there ? B[k] : 0.0, record.line[k][2] = there ? C[k] : double(kNoEdge);
    }
    record.opacity = opacity, record.rho = float(rho), record.limit = float(limit), record.z = float(view.zc);
    color_of(cam, centre, in.looks, i, record.color);
    return true;
}

}  // namespace e4dgs

using namespace e4dgs;

// Blocks that should fit on a multiprocessor at once. Left to itself (0), the compiler spills a few registers of the antialiased mode to fit
// a third one.
constexpr int kFitting = ANTIALIASED ? 2 : 0;

// See `Slots`; depth is the centroid's. records [room]. The Gaussians have been projected before.
extern "C" __global__ void __launch_bounds__(kProjectThreads, kFitting)
    project_convexes(const double* camera, int width, int height, int n, const float* points, const float* tau, const float* kappa, const float* opacities,
                     const float* looks, const float* extras, int channels, int room, uint64* workspace, int64* counts, int* slots, int* ids, double* depth,
                     TileBox* boxes, uint8* visible, ConvexRecord* records) {
    __shared__ ConvexRecord made[kProjectThreads];
    const Slots all = {n, room, workspace, slots, ids, depth, boxes, visible};
    const int64 block = all.take_block(), i = block * kProjectThreads + threadIdx.x, first = counts[kKeptGaussians];
    const Camera<double>& cam = camera_of(camera, width, height);
    const ConvexInputs in = {points, tau, kappa, opacities, looks, extras, channels};
    TileBox box;
    double z;
    const bool there = i < n && project(in, cam, i, made[threadIdx.x], box, z);
    int64 seen;
    const int slot = all.take(block, i, first, there, box, z, seen);
    if (slot >= 0) records[slot] = made[threadIdx.x];
    if (all.ends(block)) {
        counts[kSeenConvexes] = seen;
        counts[kKept] = first + (seen < room ? seen : room);
    }
}
