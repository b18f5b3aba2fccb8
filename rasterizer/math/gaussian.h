// A 3D Gaussian seen by a pinhole camera: EWA splatting as in 3DGS (Kerbl et al. 2023), forward and backward.
#pragma once
#include "antialias.h"

namespace e4dgs {

template <class T>
struct GaussianView {
    T p[3];           // centre, camera frame
    T mean[2];        // px
    T cov[3];         // xx, xy, yy of the 2D covariance, px^2, including the dilation d
    T det;            // its determinant
    T q[4], q_scale;  // unit quaternion; q = q_scale * quat
    T rot[9];         // rotation matrix of the quaternion
    T m[9];           // rot * diag(scale)
    T slope[2];       // x/z, y/z as used in the Jacobian (clamped)
    Truth<T> clamped[2];
    T tm[6];          // Jacobian * R, 2x3
    T b[6];           // tm * m, 2x3; cov = b b^T + d I
};

template <class T>
E4DGS_HD void clamp_slope(T slope, T low, T high, T& value, Truth<T>& clamped) {
    clamped = (slope < low) | (slope > high);
    value = choose(slope < low, low, choose(slope > high, high, slope));
}

// px^2, added to the 2D covariance in the mode AA.
template <bool AA>
E4DGS_HD constexpr double dilation_of() {
    return AA ? kPixelVariance : kDilation;
}

// Returns false if the Gaussian is culled (centre nearer than near_z, or zero quaternion); then the view is meaningless.
template <bool AA, class T, class S>
E4DGS_HD Truth<T> project_gaussian(const Camera<T>& cam, const S* mean, const S* quat, const S* scale, GaussianView<T>& v) {
    to_camera(cam, mean, v.p);
    const T z = v.p[2];
    Truth<T> good = z >= T(cam.near_z);
    if (none(good)) return good;

    // Divide by the largest component first, so that tiny and huge quaternions stay in range.
    T largest = T(0);
    for (int i = 0; i < 4; ++i) largest = larger(largest, fabs(T(quat[i])));
    good = good & (largest > T(0));
    if (none(good)) return good;
    T norm2 = T(0);
    for (int i = 0; i < 4; ++i) v.q[i] = T(quat[i]) / largest, norm2 += v.q[i] * v.q[i];
    const T inverse = T(1) / sqrt(norm2);
    for (int i = 0; i < 4; ++i) v.q[i] *= inverse;
    v.q_scale = inverse / largest;
    const T qw = v.q[0], qx = v.q[1], qy = v.q[2], qz = v.q[3];
    v.rot[0] = 1 - 2 * (qy * qy + qz * qz), v.rot[1] = 2 * (qx * qy - qw * qz), v.rot[2] = 2 * (qx * qz + qw * qy);
    v.rot[3] = 2 * (qx * qy + qw * qz), v.rot[4] = 1 - 2 * (qx * qx + qz * qz), v.rot[5] = 2 * (qy * qz - qw * qx);
    v.rot[6] = 2 * (qx * qz - qw * qy), v.rot[7] = 2 * (qy * qz + qw * qx), v.rot[8] = 1 - 2 * (qx * qx + qy * qy);
    for (int k = 0; k < 3; ++k)
        for (int j = 0; j < 3; ++j) v.m[3 * k + j] = v.rot[3 * k + j] * T(scale[j]);

    const T x = v.p[0] / z, y = v.p[1] / z;
    v.mean[0] = cam.fx * x + cam.cx, v.mean[1] = cam.fy * y + cam.cy;
    clamp_slope(x, cam.low[0], cam.high[0], v.slope[0], v.clamped[0]);
    clamp_slope(y, cam.low[1], cam.high[1], v.slope[1], v.clamped[1]);
    const T ax = cam.fx / z, ay = cam.fy / z;
    for (int j = 0; j < 3; ++j) {
        v.tm[j] = ax * (cam.R[j] - v.slope[0] * cam.R[6 + j]);
        v.tm[3 + j] = ay * (cam.R[3 + j] - v.slope[1] * cam.R[6 + j]);
    }
    for (int i = 0; i < 2; ++i)
        for (int j = 0; j < 3; ++j)
            v.b[3 * i + j] = v.tm[3 * i] * v.m[j] + v.tm[3 * i + 1] * v.m[3 + j] + v.tm[3 * i + 2] * v.m[6 + j];

    const T *b0 = v.b, *b1 = v.b + 3;
    const T xx = b0[0] * b0[0] + b0[1] * b0[1] + b0[2] * b0[2], yy = b1[0] * b1[0] + b1[1] * b1[1] + b1[2] * b1[2];
    const T k0 = b0[1] * b1[2] - b0[2] * b1[1], k1 = b0[2] * b1[0] - b0[0] * b1[2], k2 = b0[0] * b1[1] - b0[1] * b1[0];
    const T dilation = T(dilation_of<AA>());
    v.cov[0] = xx + dilation;
    v.cov[1] = b0[0] * b1[0] + b0[1] * b1[1] + b0[2] * b1[2];
    v.cov[2] = yy + dilation;
    // |b0 x b1|^2 + d trace + d^2 is a sum of squares, so needle-shaped Gaussians suffer no cancellation.
    v.det = k0 * k0 + k1 * k1 + k2 * k2 + dilation * (xx + yy) + dilation * dilation;
    return good;
}

// f for the exponent in alpha = 2^(log2(opacity) - u^2 - v^2), where u = f[0] dx + f[1] dy, v = f[2] dy and (dx, dy) = pixel - mean.
// It is a triangular factor of the inverse covariance. Again there is no cancellation, because squares are only added.
template <class T>
E4DGS_HD void exponent_factor(const GaussianView<T>& v, T* f) {
    const T half = sqrt(T(0.5 * kLog2E));
    const T sy = sqrt(v.cov[2]), inverse = T(1) / sqrt(v.det);
    f[0] = half * sy * inverse;
    f[1] = -half * v.cov[1] / sy * inverse;
    f[2] = half / sy;
}

// The antialiased mode's factor on the opacity, squared: det cov / det (cov + d I). The first is |b0 x b1|^2, again without cancellation.
template <class T>
E4DGS_HD T dilation_share2(const GaussianView<T>& v, T* k) {
    const T *b0 = v.b, *b1 = v.b + 3;
    k[0] = b0[1] * b1[2] - b0[2] * b1[1], k[1] = b0[2] * b1[0] - b0[0] * b1[2], k[2] = b0[0] * b1[1] - b0[1] * b1[0];
    return (k[0] * k[0] + k[1] * k[1] + k[2] * k[2]) / v.det;
}

// g: gradient of ln sqrt(dilation_share2), which must not be 0. Adds to db [6].
template <class T>
E4DGS_HD void dilation_share_backward(const GaussianView<T>& v, T g, T* db) {
    T k[3];
    const T dilation = T(kPixelVariance), share2 = dilation_share2(v, k), down = dilation * g / v.det;
    const T *b0 = v.b, *b1 = v.b + 3;
    const T xx = b0[0] * b0[0] + b0[1] * b0[1] + b0[2] * b0[2], yy = b1[0] * b1[0] + b1[1] * b1[1] + b1[2] * b1[2];
    // d/dk: k (1 / |k|^2 - 1 / det), and det - |k|^2 = d (xx + yy) + d^2
    const T up = down * (xx + yy + dilation) / (share2 * v.det);
    for (int i = 0; i < 3; ++i) {
        const int j = (i + 1) % 3, m = (i + 2) % 3;
        db[i] += up * (b1[j] * k[m] - b1[m] * k[j]) - down * b0[i];
        db[3 + i] += up * (k[j] * b0[m] - k[m] * b0[j]) - down * b1[i];
    }
}

// Converts the moments of the exponent's gradient over the pixels, moments = sum g * (u, v, uu, uv, vv), to the gradients of the 2D
// mean [2] and covariance [3] (xx, xy counted once, yy).
template <class T>
E4DGS_HD void moments_backward(const T* f, const T* moments, T* dmean, T* dcov) {
    dmean[0] = 2 * f[0] * moments[0];
    dmean[1] = 2 * (f[1] * moments[0] + f[2] * moments[1]);
    const T c = T(2 / kLog2E), uu = moments[2], uv = moments[3], vv = moments[4];
    const T a0 = f[0] * uu, a1 = f[0] * uv;                              // F^T M, first row, with F = [[f0 f1] [0 f2]]
    const T b0 = f[1] * uu + f[2] * uv, b1 = f[1] * uv + f[2] * vv;
    dcov[0] = c * a0 * f[0];
    dcov[1] = c * (a0 * f[1] + a1 * f[2]);
    dcov[2] = c * (b0 * f[1] + b1 * f[2]);
}

// G is CameraGrad<T>, or a type that ignores what is added to it.
// dmean2 [2] px, dcov [3] with dL = dcov0 dxx + 2 dcov1 dxy + dcov2 dyy, dz: gradient of the centre's depth.
// g: gradient of ln opacity, used in the antialiased mode (AA), where the covariance and the depth change the opacity.
// Adds to dmean, dquat and dscale.
template <bool AA, class T, class S, class G>
E4DGS_HD void project_gaussian_backward(const Camera<T>& cam, const GaussianView<T>& v, const S* mean, const S* scale, const T* dmean2,
                                        const T* dcov, T dz, T g, T* dmean, T* dquat, T* dscale, G& grad) {
    const T z = v.p[2], iz = T(1) / z, x = v.p[0] * iz, y = v.p[1] * iz;
    T db[6];
    for (int j = 0; j < 3; ++j) {
        db[j] = 2 * (dcov[0] * v.b[j] + dcov[1] * v.b[3 + j]);
        db[3 + j] = 2 * (dcov[1] * v.b[j] + dcov[2] * v.b[3 + j]);
    }
    if constexpr (AA) {
        dilation_share_backward(v, g, db);
        dz += g * fade_slope(z, cam.near_z);
    }
    T drot[9], dtm[6];
    for (int k = 0; k < 3; ++k)
        for (int j = 0; j < 3; ++j) {
            const T dm = v.tm[k] * db[j] + v.tm[3 + k] * db[3 + j];
            drot[3 * k + j] = dm * T(scale[j]);
            dscale[j] += dm * v.rot[3 * k + j];
        }
    for (int i = 0; i < 2; ++i)
        for (int k = 0; k < 3; ++k)
            dtm[3 * i + k] = db[3 * i] * v.m[3 * k] + db[3 * i + 1] * v.m[3 * k + 1] + db[3 * i + 2] * v.m[3 * k + 2];

    // tm = (f/z) (R_row - slope R_2)
    const T ax = cam.fx * iz, ay = cam.fy * iz;
    T dax = T(0), day = T(0), dsx = T(0), dsy = T(0);
    for (int j = 0; j < 3; ++j) {
        dax += dtm[j] * (cam.R[j] - v.slope[0] * cam.R[6 + j]);
        day += dtm[3 + j] * (cam.R[3 + j] - v.slope[1] * cam.R[6 + j]);
        dsx -= ax * dtm[j] * cam.R[6 + j];
        dsy -= ay * dtm[3 + j] * cam.R[6 + j];
        grad.R[j] += ax * dtm[j];
        grad.R[3 + j] += ay * dtm[3 + j];
        grad.R[6 + j] -= ax * v.slope[0] * dtm[j] + ay * v.slope[1] * dtm[3 + j];
    }
    const T dx = cam.fx * dmean2[0] + choose(v.clamped[0], T(0), dsx);  // gradient of x/z
    const T dy = cam.fy * dmean2[1] + choose(v.clamped[1], T(0), dsy);
    grad.fx += dax * iz + x * dmean2[0], grad.cx += dmean2[0];
    grad.fy += day * iz + y * dmean2[1], grad.cy += dmean2[1];
    const T dp[3] = {dx * iz, dy * iz, dz - (dx * x + dy * y) * iz - (dax * ax + day * ay) * iz};
    to_camera_backward(cam, mean, dp, dmean, grad);

    const T w = v.q[0], qx = v.q[1], qy = v.q[2], qz = v.q[3];
    const T* d = drot;
    const T dq[4] = {
        2 * (qz * (d[3] - d[1]) + qy * (d[2] - d[6]) + qx * (d[7] - d[5])),
        2 * (qy * (d[1] + d[3]) + qz * (d[2] + d[6]) + w * (d[7] - d[5]) - 2 * qx * (d[4] + d[8])),
        2 * (qx * (d[1] + d[3]) + qz * (d[5] + d[7]) + w * (d[2] - d[6]) - 2 * qy * (d[0] + d[8])),
        2 * (qx * (d[2] + d[6]) + qy * (d[5] + d[7]) + w * (d[3] - d[1]) - 2 * qz * (d[0] + d[4])),
    };
    const T along = v.q[0] * dq[0] + v.q[1] * dq[1] + v.q[2] * dq[2] + v.q[3] * dq[3];
    for (int i = 0; i < 4; ++i) dquat[i] += (dq[i] - along * v.q[i]) * v.q_scale;
}

}  // namespace e4dgs
