// What the antialiased mode adds to projection, forward and backward; docs/maths.md, "Antialiased mode", has the formulas. Nothing of it is
// computed per pixel: the mode only changes a primitive's blur, opacity, sharpness and points.
#pragma once
#include "camera.h"

namespace e4dgs {

// From 10 % to 90 % of its height, an edge is 2 ln 9 / kappa wide. A sharp edge seen through a pixel's box is 0.8 pixels wide.
constexpr double kPixelEdge = 0.18204784532536746;  // 0.8 / (2 ln 9)
// The integral of M over a hull of area A and perimeter P, relative to A, is about sqrt(1 + a / x^2 + b / x^4) with x = kappa 2 A / P.
constexpr double kBlurWide = 6.579736267392906;   // a = 2 pi^2 / 3, from hulls much wider than their edges
constexpr double kBlurThin = 2.705808084277845;   // b = (pi^2 / 6)^2, from hulls much thinner

constexpr double kOffCamera = 1e-6;  // times near_z

// The factor on opacities close to the camera: 0 at near_z, 1 from 2 near_z on, with a continuous slope.
template <class T>
E4DGS_HD T fade(T z, T near_z) {
    const T t = smaller(larger((z - near_z) / near_z, T(0)), T(1));
    return t * t * (T(3) - T(2) * t);
}

// d ln fade / dz, where fade is above 0.
template <class T>
E4DGS_HD T fade_slope(T z, T near_z) {
    const T t = smaller(larger((z - near_z) / near_z, T(0)), T(1));
    return T(6) * (T(1) - t) / (larger(t * (T(3) - T(2) * t), T(1e-30)) * near_z);
}

// The mean of the points [count][3] in front of near_z, weighted by their distance from that plane, so that a point that crosses the plane
// changes nothing suddenly. Returns false if there is no such point.
template <class T>
E4DGS_HD Truth<T> mean_in_front(const T (*p)[3], int count, T near_z, T* mean, T& weight) {
    weight = mean[0] = mean[1] = mean[2] = T(0);
    for (int i = 0; i < count; ++i) {
        const T w = larger(p[i][2] - near_z, T(0));
        weight += w;
        for (int j = 0; j < 3; ++j) mean[j] += w * p[i][j];
    }
    const Truth<T> some = weight > T(0);
    const T inverse = T(1) / choose(some, weight, T(1));
    for (int j = 0; j < 3; ++j) mean[j] *= inverse;
    return some;
}

// Clips at the plane z = near_z: a point nearer than it is replaced by the intersection of the plane with the line from the point to
// mean_in_front. This lies in the convex's hull, and the convex keeps its number of points. Returns false if nothing is in front.
template <class T>
E4DGS_HD Truth<T> clip_points(T (*p)[3], int count, T near_z) {
    T mean[3], weight;
    const Truth<T> some = mean_in_front(p, count, near_z, mean, weight);
    for (int i = 0; i < count; ++i) {
        const Truth<T> behind = some & (p[i][2] < near_z);
        const T s = (near_z - p[i][2]) / choose(behind, mean[2] - p[i][2], T(1));
        for (int j = 0; j < 2; ++j) p[i][j] = choose(behind, p[i][j] + s * (mean[j] - p[i][j]), p[i][j]);
        p[i][2] = choose(behind, near_z, p[i][2]);
    }
    return some;
}

// p: the points before clipping. Turns dp, the gradients of the clipped points, into those of the points.
template <class T>
E4DGS_HD void clip_points_backward(const T (*p)[3], int count, T near_z, T (*dp)[3]) {
    T mean[3], weight, dmean[3] = {T(0), T(0), T(0)};
    const Truth<T> some = mean_in_front(p, count, near_z, mean, weight);
    for (int i = 0; i < count; ++i) {
        const Truth<T> behind = some & (p[i][2] < near_z);
        const T inverse = T(1) / choose(behind, mean[2] - p[i][2], T(1)), s = (near_z - p[i][2]) * inverse;
        const T ds = dp[i][0] * (mean[0] - p[i][0]) + dp[i][1] * (mean[1] - p[i][1]);
        for (int j = 0; j < 2; ++j) {
            dmean[j] += choose(behind, s * dp[i][j], T(0));
            dp[i][j] = choose(behind, (T(1) - s) * dp[i][j], dp[i][j]);
        }
        dmean[2] -= choose(behind, s * ds * inverse, T(0));
        dp[i][2] = choose(behind, ds * (near_z - mean[2]) * inverse * inverse, dp[i][2]);
    }
    const T inverse = T(1) / choose(some, weight, T(1));
    for (int i = 0; i < count; ++i) {
        const T w = larger(p[i][2] - near_z, T(0)) * inverse;
        T along = T(0);
        for (int j = 0; j < 3; ++j) {
            along += dmean[j] * (p[i][j] - mean[j]);
            dp[i][j] += w * dmean[j];
        }
        dp[i][2] += choose(p[i][2] > near_z, along * inverse, T(0));
    }
}

// The centroid [3] of a clipped convex, before clipping, may be the camera's centre, from which there is no view direction. It is then
// moved forward a little. World coordinates.
template <class T>
E4DGS_HD void keep_off_camera(const Camera<T>& cam, T* centroid) {
    T distance2 = T(0);
    for (int j = 0; j < 3; ++j) distance2 += (centroid[j] - cam.centre[j]) * (centroid[j] - cam.centre[j]);
    const T least = T(kOffCamera) * cam.near_z;
    const Truth<T> on_it = distance2 < least * least;
    for (int j = 0; j < 3; ++j) centroid[j] = choose(on_it, cam.centre[j] + least * cam.R[6 + j], centroid[j]);
}

// A convex whose edges are no sharper than a pixel. With t = (limited kappa / kappa)^2 and r = (limited kappa 2 A / P)^2, A and P in world
// units at the centroid's depth, share^2 = (r^2 + a t r + b t^2) / (r^2 + a r + b).
template <class T>
struct Footprint {
    T kappa;  // the limited sharpness
    T share;  // factor on the opacity
    T t, rest, r, over, under;  // rest = 1 - t; numerator and denominator of share^2
};

// area, perimeter: of the hull in the plane (x/z, y/z).
template <class T>
E4DGS_HD Footprint<T> footprint(const Camera<T>& cam, T area, T perimeter, T zc, T kappa) {
    Footprint<T> f;
    const T a = T(kBlurWide), b = T(kBlurThin), at_depth = kappa * zc, pixel = at_depth * T(kPixelEdge), inner = at_depth * 2 * area / perimeter;
    const T u = pixel * pixel / (cam.fx * cam.fy);
    f.t = T(1) / (T(1) + u), f.rest = u * f.t;
    f.kappa = kappa * sqrt(f.t);
    f.r = f.t * inner * inner;
    f.over = f.r * f.r + a * f.t * f.r + b * f.t * f.t;
    f.under = f.r * f.r + a * f.r + b;
    f.share = sqrt(f.over / f.under);
    return f;
}

// g: gradient of ln share. dlimited: gradient of the limited kappa. Writes dkappa, darea and dperimeter; adds to dz, the gradient of zc.
template <class T, class G>
E4DGS_HD void footprint_backward(const Camera<T>& cam, const Footprint<T>& f, T area, T perimeter, T zc, T kappa, T g, T dlimited, T& dkappa,
                                 T& darea, T& dperimeter, T& dz, G& grad) {
    const T a = T(kBlurWide), b = T(kBlurThin), half = T(0.5) * g;
    // Gradients of ln r, of ln t at constant r, and of ln of the limited kappa.
    const T gr = half * f.r * ((2 * f.r + a * f.t) / f.over - (2 * f.r + a) / f.under);
    const T gt = half * f.t * (a * f.r + 2 * b * f.t) / f.over, gk = dlimited * f.kappa;
    dkappa = (f.t * (gk + 2 * gr) - 2 * f.rest * gt) / kappa;
    dz += (2 * f.t * gr - f.rest * (2 * gt + gk)) / zc;
    const T df = f.rest * (gt + gr + T(0.5) * gk);
    grad.fx += df / cam.fx, grad.fy += df / cam.fy;
    darea = 2 * gr / area, dperimeter = -2 * gr / perimeter;
}

}  // namespace e4dgs
