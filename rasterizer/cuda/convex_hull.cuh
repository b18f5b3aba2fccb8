// A convex seen by the camera, with the corners of its hull. Features: POINTS, ANTIALIASED.
#pragma once
#include "inputs.cuh"
//
#include "convex.h"
#include "hull.h"

namespace e4dgs {

struct HullPlane {
    const ConvexView<double>& v;
    __device__ double x(int i) const { return v.x[i]; }
    __device__ double y(int i) const { return v.y[i]; }
};

__device__ inline bool see_convex(const Camera<double>& cam, const float* points, ConvexView<double>& view) {
    return project_convex<bool(ANTIALIASED)>(cam, points, POINTS, view, [](ConvexView<double>& v, bool& good) {
        int corner[kMaxPoints];
        const int n = hull_corners(HullPlane{v}, v.points, corner);
        v.slots = n;
        for (int k = 0; k < n; ++k) v.corner[k] = corner[k], v.edge[k] = true;
        v.corner[n] = n ? corner[0] : 0;
        good = good && n > 0;
    });
}

// The mean of p [POINTS][3].
__device__ inline void mean_of(const double (*p)[3], double* mean) {
    for (int j = 0; j < 3; ++j) {
        mean[j] = 0.0;
        for (int k = 0; k < POINTS; ++k) mean[j] += p[k][j] / POINTS;
    }
}

__device__ inline void centroid_of(const float* points, double* centre) {
    centre[0] = centre[1] = centre[2] = 0.0;
    for (int k = 0; k < POINTS; ++k)
        for (int j = 0; j < 3; ++j) centre[j] += double(points[3 * k + j]) / POINTS;
}

}  // namespace e4dgs
