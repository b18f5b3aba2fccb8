// A smooth convex seen by a pinhole camera (Edge4DGS, Eq. 3-7): the hull of K projected points, with one plane per edge, forward and
// backward. For a pixel ray d (d.z = 1) and z_c the z of the mean of all K points, H_i = u_i . (z_c d),
// S = (1/tau) ln sum_i w_i exp(tau H_i) with w_i = K l_i / sum(l), alpha = opacity / (1 + exp(kappa S)).
// T is a number, or a vector of numbers for several convexes. Their hulls may have different numbers of edges, so a slot can be empty.
#pragma once
#include "antialias.h"

namespace e4dgs {

template <class T>
struct ConvexView {
    int points, slots;                         // K; number of slots in use
    Truth<T> edge[kMaxPoints];                 // whether slot k holds an edge; it runs from corner k to corner k + 1
    Index<T> corner[kMaxPoints + 1];           // point indices; after the last corner, the first one again
    T p[kMaxPoints][3];                        // all points, camera frame
    T x[kMaxPoints], y[kMaxPoints];            // all points in the plane (x/z, y/z)
    T cx[kMaxPoints + 1], cy[kMaxPoints + 1];  // the corners in the plane
    T zc;                                      // z of the centroid
    T length[kMaxPoints], perimeter;           // edge lengths in the plane, and their sum
    T ex[kMaxPoints], ey[kMaxPoints];          // unit directions of the edges
    T u[kMaxPoints][3], inverse_norm[kMaxPoints];
};

// Area of the hull in the plane. In empty slots, corner 0 appears twice and the triangle has no area.
template <class T>
E4DGS_HD T area_of(const ConvexView<T>& v) {
    T area = T(0);
    for (int k = 1; k + 1 < v.slots; ++k)
        area += T(0.5) * ((v.cx[k] - v.cx[0]) * (v.cy[k + 1] - v.cy[0]) - (v.cy[k] - v.cy[0]) * (v.cx[k + 1] - v.cx[0]));
    return area;
}

// Returns false if the convex is culled (a hull that is a point, a line or a sliver; a point nearer than near_z, or in the antialiased
// mode (AA), which clips, all of them). points [K][3], world. find_corners(view, good) computes slots, edge and corner from x and y.
template <bool AA, class T, class S, class F>
E4DGS_HD Truth<T> project_convex(const Camera<T>& cam, const S* points, int count, ConvexView<T>& v, F&& find_corners) {
    v.points = count;
    v.zc = T(0);
    Truth<T> good = T(0) <= T(0);
    for (int i = 0; i < count; ++i) {
        to_camera(cam, points + 3 * i, v.p[i]);
        if constexpr (!AA) {
            good = good & (v.p[i][2] >= cam.near_z);
            v.zc += v.p[i][2];
        }
    }
    if constexpr (AA) {
        good = good & clip_points(v.p, count, cam.near_z);
        for (int i = 0; i < count; ++i) v.zc += v.p[i][2];
    }
    if (none(good)) return good;
    v.zc = v.zc / T(count);
    for (int i = 0; i < count; ++i) {
        const T z = choose(good, v.p[i][2], T(1));
        v.x[i] = v.p[i][0] / z, v.y[i] = v.p[i][1] / z;
    }
    find_corners(v, good);
    for (int k = 0; k <= v.slots; ++k) v.cx[k] = pick(v.x, v.corner[k]), v.cy[k] = pick(v.y, v.corner[k]);

    T low_x = v.x[0], high_x = v.x[0], low_y = v.y[0], high_y = v.y[0];
    for (int i = 1; i < count; ++i) {
        low_x = smaller(low_x, v.x[i]), high_x = larger(high_x, v.x[i]);
        low_y = smaller(low_y, v.y[i]), high_y = larger(high_y, v.y[i]);
    }
    const T area = area_of(v), extent = larger(high_x - low_x, high_y - low_y);
    good = good & (area > T(kDegenerateHull) * extent * extent);
    if (none(good)) return good;

    v.perimeter = T(0);
    for (int k = 0; k < v.slots; ++k) {
        const T dx = v.cx[k + 1] - v.cx[k], dy = v.cy[k + 1] - v.cy[k];
        // In double, differences of float coordinates neither overflow nor underflow.
        v.length[k] = choose(v.edge[k], sqrt(dx * dx + dy * dy), T(1));
        v.perimeter += choose(v.edge[k], v.length[k], T(0));
        // normalize(b x a) with both at z = 1 and the edge at unit length. The vector's length is at least 1, however short the edge.
        v.ex[k] = dx / v.length[k], v.ey[k] = dy / v.length[k];
        const T n0 = v.ey[k], n1 = -v.ex[k], n2 = v.cy[k] * v.ex[k] - v.cx[k] * v.ey[k];
        v.inverse_norm[k] = T(1) / sqrt(T(1) + n2 * n2);
        v.u[k][0] = n0 * v.inverse_norm[k], v.u[k][1] = n1 * v.inverse_norm[k], v.u[k][2] = n2 * v.inverse_norm[k];
    }
    return good;
}

template <class T>
E4DGS_HD T log_weight(const ConvexView<T>& v, int k) {  // log2 w_k
    return log2(T(v.points) * v.length[k] / v.perimeter);
}

// L_i(pixel) = log2(w_i exp(tau H_i)) = A_i (px - x0) + B_i (py - y0) + C_i, so that tau S = ln 2 * log2 sum_i 2^L_i.
// Do not read the results of slots without an edge.
template <class T>
E4DGS_HD void edge_lines(const Camera<T>& cam, const ConvexView<T>& v, T tau, T x0, T y0, T* A, T* B, T* C) {
    const T k = tau * v.zc * T(kLog2E), dx = (x0 - cam.cx) / cam.fx, dy = (y0 - cam.cy) / cam.fy;
    for (int i = 0; i < v.slots; ++i) {
        A[i] = k * v.u[i][0] / cam.fx;
        B[i] = k * v.u[i][1] / cam.fy;
        C[i] = k * (v.u[i][0] * dx + v.u[i][1] * dy + v.u[i][2]) + log_weight(v, i);
    }
}

// gA, gB, gC: gradients of the lines' coefficients, 0 in slots without an edge. drho: gradient of kappa / tau. dz: gradient of the
// centroid's depth. dspread: sum over pixels of dL/d(rho lse) (lse - sum_i p_i L_i), where p is the softmax of the lines, because
// d(rho lse)/dtau = -(kappa / tau^2) (lse - sum_i p_i (L_i - log2 w_i)). Adds to dpoints [K][3], dtau and dkappa. The gradient of a
// vanishing edge is gC_i / l_i; it stays finite because gC_i is proportional to w_i. darea, dperimeter: gradients of the hull's area and
// perimeter, used in the antialiased mode (AA), in which kappa is the limited one and dz includes all that depends on the depth.
template <bool AA, class T, class S, class G>
E4DGS_HD void project_convex_backward(const Camera<T>& cam, const ConvexView<T>& v, const S* points, T tau, T kappa, T x0, T y0,
                                      const T* gA, const T* gB, const T* gC, T drho, T dspread, T dz, T darea, T dperimeter, T* dpoints,
                                      T& dtau, T& dkappa, G& grad) {
    const T k = tau * v.zc * T(kLog2E), dx0 = (x0 - cam.cx) / cam.fx, dy0 = (y0 - cam.cy) / cam.fy;
    T dcx[kMaxPoints + 1], dcy[kMaxPoints + 1], dx[kMaxPoints], dy[kMaxPoints], dk = T(0), total = T(0), along_weights = T(0);
    for (int i = 0; i <= v.slots; ++i) dcx[i] = dcy[i] = T(0);
    for (int i = 0; i < v.points; ++i) dx[i] = dy[i] = T(0);
    for (int i = 0; i < v.slots; ++i) {
        total += gC[i];
        along_weights += gC[i] * log_weight(v, i);
    }
    for (int i = 0; i < v.slots; ++i) {
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
        const T ex = v.ex[i], ey = v.ey[i];
        const T dex = -dn1 + v.cy[i] * dn2, dey = dn0 - v.cx[i] * dn2;
        const T inward = ex * dex + ey * dey, il = T(1) / v.length[i];
        T dl = choose(v.edge[i], (gC[i] * il - total / v.perimeter) * T(kLog2E), T(0));
        if constexpr (AA) {
            dl += choose(v.edge[i], dperimeter, T(0));
            const T half = T(0.5) * darea;
            dcx[i] += half * v.cy[i + 1], dcy[i] -= half * v.cx[i + 1];
            dcx[i + 1] -= half * v.cy[i], dcy[i + 1] += half * v.cx[i];
        }
        const T vx = (dex - ex * inward) * il + ex * dl, vy = (dey - ey * inward) * il + ey * dl;
        dcx[i] -= ey * dn2 + vx, dcy[i] += ex * dn2 - vy;
        dcx[i + 1] += vx, dcy[i + 1] += vy;
    }
    for (int i = 0; i <= v.slots; ++i) add_at(dx, v.corner[i], dcx[i]), add_at(dy, v.corner[i], dcy[i]);
    dtau -= dspread * kappa / (tau * tau) + along_weights / tau;
    dkappa += drho / tau;
    const T share = (dk * tau * T(kLog2E) + dz) / T(v.points);
    T before[kMaxPoints][3], clipped[kMaxPoints][3];  // points before clipping; gradients of the clipped ones
    for (int i = 0; i < v.points; ++i) {
        const T iz = T(1) / v.p[i][2];
        const T dp[3] = {dx[i] * iz, dy[i] * iz, share - (dx[i] * v.x[i] + dy[i] * v.y[i]) * iz};
        if constexpr (AA) {
            to_camera(cam, points + 3 * i, before[i]);
            for (int j = 0; j < 3; ++j) clipped[i][j] = dp[j];
        } else {
            to_camera_backward(cam, points + 3 * i, dp, dpoints + 3 * i, grad);
        }
    }
    if constexpr (AA) {
        clip_points_backward(before, v.points, cam.near_z, clipped);
        for (int i = 0; i < v.points; ++i) to_camera_backward(cam, points + 3 * i, clipped[i], dpoints + 3 * i, grad);
    }
}

}  // namespace e4dgs
