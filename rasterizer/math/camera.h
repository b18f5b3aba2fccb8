// A pinhole camera (OpenCV axes, pixel centres at +0.5) and the gradient that primitives propagate to it.
#pragma once
#include "constants.h"

namespace e4dgs {

template <class T>
struct Camera {
    T fx, fy, cx, cy;
    T R[9], t[3];       // camera = R world + t, row-major
    T centre[3];        // -R^T t
    T low[2], high[2];  // a Gaussian's Jacobian uses slopes x/z, y/z between these
    T near_z;
    int width, height;
};

template <class T>
struct CameraGrad {
    T fx, fy, cx, cy;
    T R[9], t[3];
};

template <class T>
E4DGS_HD void limit_slope(int size, T focal, T principal, T& low, T& high) {
    const T margin = T(0.3) * T(size) / (2 * focal);
    low = -principal / focal - margin, high = (T(size) - principal) / focal + margin;
}

// Computes centre, low and high from the rest.
template <class T>
E4DGS_HD void complete(Camera<T>& cam) {
    for (int j = 0; j < 3; ++j)
        cam.centre[j] = -(cam.R[j] * cam.t[0] + cam.R[3 + j] * cam.t[1] + cam.R[6 + j] * cam.t[2]);
    limit_slope(cam.width, cam.fx, cam.cx, cam.low[0], cam.high[0]);
    limit_slope(cam.height, cam.fy, cam.cy, cam.low[1], cam.high[1]);
}

template <class T, class S>
E4DGS_HD void to_camera(const Camera<T>& cam, const S* world, T* p) {
    for (int i = 0; i < 3; ++i)
        p[i] = cam.R[3 * i] * T(world[0]) + cam.R[3 * i + 1] * T(world[1]) + cam.R[3 * i + 2] * T(world[2]) + cam.t[i];
}

// dworld += R^T dp; the camera's gradient is added to grad.
template <class T, class S, class G>
E4DGS_HD void to_camera_backward(const Camera<T>& cam, const S* world, const T* dp, T* dworld, G& grad) {
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) {
            dworld[j] += cam.R[3 * i + j] * dp[i];
            grad.R[3 * i + j] += dp[i] * T(world[j]);
        }
        grad.t[i] += dp[i];
    }
}

// centre = -R^T t
template <class T, class G>
E4DGS_HD void centre_backward(const Camera<T>& cam, const T* dcentre, G& grad) {
    for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 3; ++j) {
            grad.R[3 * i + j] -= cam.t[i] * dcentre[j];
            grad.t[i] -= cam.R[3 * i + j] * dcentre[j];
        }
}

}  // namespace e4dgs
