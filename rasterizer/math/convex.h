// A smooth convex seen by a pinhole camera (Edge4DGS, Eq. 3-7): the hull of K projected points, one plane an edge, forward and
// backward. For a pixel ray d (d.z = 1) and z_c the z of the mean of all K points, H_i = u_i . (z_c d),
// S = (1/tau) ln sum_i w_i exp(tau H_i) with w_i = K l_i / sum(l), alpha = opacity / (1 + exp(kappa S)).
#pragma once
#include "camera.h"

namespace e4dgs {

template <class T>
struct ConvexView {
    int points;                          // K
    int n;                               // corners, which are edges too: edge i runs from corner i to corner i + 1
    int corner[kMaxPoints];              // indices of points
    T p[kMaxPoints][3];                  // all points, camera frame
    T x[kMaxPoints], y[kMaxPoints];      // all points in the plane (x/z, y/z)
    T zc;                                // z of the centroid
    T length[kMaxPoints], perimeter;     // of the edges in the plane
    T ex[kMaxPoints], ey[kMaxPoints];    // unit directions of the edges
    T u[kMaxPoints][3], inverse_norm[kMaxPoints];
};

template <class T>
E4DGS_HD T turn(const ConvexView<T>& v, int a, int b, int c) {
    return (v.x[b] - v.x[a]) * (v.y[c] - v.y[a]) - (v.y[b] - v.y[a]) * (v.x[c] - v.x[a]);
}

// Graham's scan in Andrew's variant. Corners are the extreme points only; of coincident points one is. n < 3: no area.
template <class T>
E4DGS_HD void hull_corners(ConvexView<T>& v) {
    int order[kMaxPoints], m = 0;
    for (int i = 0; i < v.points; ++i) {
        int at = m;
        while (at > 0 && (v.x[order[at - 1]] > v.x[i] || (v.x[order[at - 1]] == v.x[i] && v.y[order[at - 1]] > v.y[i]))) --at;
        if (at > 0 && v.x[order[at - 1]] == v.x[i] && v.y[order[at - 1]] == v.y[i]) continue;
        for (int k = m; k > at; --k) order[k] = order[k - 1];
        order[at] = i;
        ++m;
    }
    v.n = 0;
    if (m < 3) return;
    int stack[2 * kMaxPoints], size = 0;
    for (int k = 0; k < m; ++k) {
        while (size > 1 && turn(v, stack[size - 2], stack[size - 1], order[k]) <= T(0)) --size;
        stack[size++] = order[k];
    }
    const int lower = size;
    for (int k = m - 2; k >= 0; --k) {
        while (size > lower && turn(v, stack[size - 2], stack[size - 1], order[k]) <= T(0)) --size;
        stack[size++] = order[k];
    }
    v.n = size - 1;  // the last is the first again
    for (int k = 0; k < v.n; ++k) v.corner[k] = stack[k];
}

// False: culled (a point nearer than near_z, or a hull that is a point, a line or a sliver).
template <class T, class S>
E4DGS_HD bool project_convex(const Camera<T>& cam, const S* points, int count, ConvexView<T>& v) {
    v.points = count;
    v.zc = T(0);
    for (int i = 0; i < count; ++i) {
        to_camera(cam, points + 3 * i, v.p[i]);
        if (!(v.p[i][2] >= cam.near_z)) return false;
        v.x[i] = v.p[i][0] / v.p[i][2], v.y[i] = v.p[i][1] / v.p[i][2];
        v.zc += v.p[i][2];
    }
    v.zc /= T(count);
    hull_corners(v);
    if (v.n < 3) return false;

    T low_x = v.x[0], high_x = v.x[0], low_y = v.y[0], high_y = v.y[0], area = T(0);
    for (int i = 1; i < count; ++i) {
        low_x = smaller(low_x, v.x[i]), high_x = larger(high_x, v.x[i]);
        low_y = smaller(low_y, v.y[i]), high_y = larger(high_y, v.y[i]);
    }
    for (int k = 1; k + 1 < v.n; ++k) area += T(0.5) * turn(v, v.corner[0], v.corner[k], v.corner[k + 1]);
    const T extent = larger(high_x - low_x, high_y - low_y);
    if (!(area > T(kDegenerateHull) * extent * extent)) return false;

    v.perimeter = T(0);
    for (int k = 0; k < v.n; ++k) {
        const int a = v.corner[k], b = v.corner[k + 1 < v.n ? k + 1 : 0];
        const T dx = v.x[b] - v.x[a], dy = v.y[b] - v.y[a];
        v.length[k] = sqrt(dx * dx + dy * dy);  // in double, differences of float coordinates neither over- nor underflow
        v.perimeter += v.length[k];
        // normalize(b x a) with both at z = 1 and the edge at unit length: at least 1 long however short the edge.
        v.ex[k] = dx / v.length[k], v.ey[k] = dy / v.length[k];
        const T n0 = v.ey[k], n1 = -v.ex[k], n2 = v.y[a] * v.ex[k] - v.x[a] * v.ey[k];
        v.inverse_norm[k] = T(1) / sqrt(T(1) + n2 * n2);
        v.u[k][0] = n0 * v.inverse_norm[k], v.u[k][1] = n1 * v.inverse_norm[k], v.u[k][2] = n2 * v.inverse_norm[k];
    }
    return true;
}

// L_i(pixel) = log2(w_i exp(tau H_i)) = A_i (px - x0) + B_i (py - y0) + C_i, so that tau S = ln 2 * log2 sum_i 2^L_i.
template <class T>
E4DGS_HD void edge_lines(const Camera<T>& cam, const ConvexView<T>& v, T tau, T x0, T y0, T* A, T* B, T* C) {
    const T k = tau * v.zc * T(kLog2E), dx = (x0 - cam.cx) / cam.fx, dy = (y0 - cam.cy) / cam.fy;
    for (int i = 0; i < v.n; ++i) {
        A[i] = k * v.u[i][0] / cam.fx;
        B[i] = k * v.u[i][1] / cam.fy;
        C[i] = k * (v.u[i][0] * dx + v.u[i][1] * dy + v.u[i][2]) + log2(T(v.points) * v.length[i] / v.perimeter);
    }
}

// gA, gB, gC: gradients of the lines' coefficients; drho: of kappa / tau; dz: of the centroid's depth. dspread: sum over pixels of
// dL/d(rho lse) (lse - sum_i p_i L_i), with p the softmax of the lines: d(rho lse)/dtau = -(kappa / tau^2) (lse - sum_i p_i (L_i - log2 w_i)). dpoints [K][3], dtau,
// dkappa are added to. A vanishing edge's gradient is gC_i / l_i with gC_i proportional to w_i: finite.
template <class T, class S, class G>
E4DGS_HD void project_convex_backward(const Camera<T>& cam, const ConvexView<T>& v, const S* points, T tau, T kappa, T x0, T y0,
                                      const T* gA, const T* gB, const T* gC, T drho, T dspread, T dz, T* dpoints, T& dtau, T& dkappa,
                                      G& grad) {
    const T k = tau * v.zc * T(kLog2E), dx0 = (x0 - cam.cx) / cam.fx, dy0 = (y0 - cam.cy) / cam.fy;
    T dx[kMaxPoints] = {}, dy[kMaxPoints] = {}, dk = T(0), total = T(0), along_weights = T(0);
    for (int i = 0; i < v.n; ++i) {
        total += gC[i];
        along_weights += gC[i] * log2(T(v.points) * v.length[i] / v.perimeter);
    }
    for (int i = 0; i < v.n; ++i) {
        const T* u = v.u[i];
        const T along_x = gA[i] / cam.fx + dx0 * gC[i], along_y = gB[i] / cam.fy + dy0 * gC[i];
        dk += u[0] * along_x + u[1] * along_y + u[2] * gC[i];
        grad.fx -= k * u[0] / (cam.fx * cam.fx) * (gA[i] + (x0 - cam.cx) * gC[i]);
        grad.fy -= k * u[1] / (cam.fy * cam.fy) * (gB[i] + (y0 - cam.cy) * gC[i]);
        grad.cx -= k * u[0] / cam.fx * gC[i];
        grad.cy -= k * u[1] / cam.fy * gC[i];

        const T du[3] = {k * along_x, k * along_y, k * gC[i]};
        const T radial = u[0] * du[0] + u[1] * du[1] + u[2] * du[2];
        const T dn0 = (du[0] - u[0] * radial) * v.inverse_norm[i], dn1 = (du[1] - u[1] * radial) * v.inverse_norm[i],
                dn2 = (du[2] - u[2] * radial) * v.inverse_norm[i];
        const int a = v.corner[i], b = v.corner[i + 1 < v.n ? i + 1 : 0];
        const T ex = v.ex[i], ey = v.ey[i];
        const T dex = -dn1 + v.y[a] * dn2, dey = dn0 - v.x[a] * dn2;
        dx[a] -= ey * dn2, dy[a] += ex * dn2;
        const T inward = ex * dex + ey * dey, il = T(1) / v.length[i];
        const T dl = (gC[i] * il - total / v.perimeter) * T(kLog2E);
        const T vx = (dex - ex * inward) * il + ex * dl, vy = (dey - ey * inward) * il + ey * dl;
        dx[b] += vx, dy[b] += vy, dx[a] -= vx, dy[a] -= vy;
    }
    dtau -= dspread * kappa / (tau * tau) + along_weights / tau;
    dkappa += drho / tau;
    const T share = (dk * tau * T(kLog2E) + dz) / T(v.points);
    for (int i = 0; i < v.points; ++i) {
        const T iz = T(1) / v.p[i][2];
        const T dp[3] = {dx[i] * iz, dy[i] * iz, share - (dx[i] * v.x[i] + dy[i] * v.y[i]) * iz};
        to_camera_backward(cam, points + 3 * i, dp, dpoints + 3 * i, grad);
    }
}

}  // namespace e4dgs
