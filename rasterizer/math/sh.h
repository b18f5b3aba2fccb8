// View-dependent colour from real spherical harmonics of degree 0 to 3, with the basis and signs of 3DGS
// (Kerbl et al. 2023): colour = max(0, sum_k B_k(direction) c_k + 0.5), without gradient through the clamp.
#pragma once
#include "camera.h"

namespace e4dgs {

// B[(D+1)^2] at the unit direction (x, y, z).
template <int D, class T>
E4DGS_HD void sh_basis(T x, T y, T z, T* B) {
    B[0] = T(0.28209479177387814);
    if constexpr (D >= 1) {
        const T c = T(0.4886025119029199);
        B[1] = -c * y, B[2] = c * z, B[3] = -c * x;
    }
    if constexpr (D >= 2) {
        const T c = T(1.0925484305920792);
        B[4] = c * x * y;
        B[5] = -c * y * z;
        B[6] = T(0.31539156525252005) * (2 * z * z - x * x - y * y);
        B[7] = -c * x * z;
        B[8] = T(0.5462742152960396) * (x * x - y * y);
    }
    if constexpr (D >= 3) {
        const T xx = x * x, yy = y * y, zz = z * z;
        B[9] = T(-0.5900435899266435) * y * (3 * xx - yy);
        B[10] = T(2.890611442640554) * x * y * z;
        B[11] = T(-0.4570457994644658) * y * (4 * zz - xx - yy);
        B[12] = T(0.3731763325901154) * z * (2 * zz - 3 * xx - 3 * yy);
        B[13] = T(-0.4570457994644658) * x * (4 * zz - xx - yy);
        B[14] = T(1.445305721320277) * z * (xx - yy);
        B[15] = T(-0.5900435899266435) * x * (xx - 3 * yy);
    }
}

// d = sum_k s_k grad B_k, where B_k are the polynomials above.
template <int D, class T>
E4DGS_HD void sh_basis_backward(T x, T y, T z, const T* s, T* d) {
    d[0] = d[1] = d[2] = T(0);
    if constexpr (D >= 1) {
        const T c = T(0.4886025119029199);
        d[0] -= c * s[3], d[1] -= c * s[1], d[2] += c * s[2];
    }
    if constexpr (D >= 2) {
        const T c = T(1.0925484305920792), c6 = T(0.31539156525252005), c8 = T(0.5462742152960396);
        d[0] += c * (y * s[4] - z * s[7]) - 2 * c6 * x * s[6] + 2 * c8 * x * s[8];
        d[1] += c * (x * s[4] - z * s[5]) - 2 * c6 * y * s[6] - 2 * c8 * y * s[8];
        d[2] += -c * (y * s[5] + x * s[7]) + 4 * c6 * z * s[6];
    }
    if constexpr (D >= 3) {
        const T xx = x * x, yy = y * y, zz = z * z, xy = x * y, xz = x * z, yz = y * z;
        const T s9 = T(-0.5900435899266435) * s[9], s10 = T(2.890611442640554) * s[10], s11 = T(-0.4570457994644658) * s[11],
                s12 = T(0.3731763325901154) * s[12], s13 = T(-0.4570457994644658) * s[13], s14 = T(1.445305721320277) * s[14],
                s15 = T(-0.5900435899266435) * s[15];
        d[0] += 6 * xy * s9 + yz * s10 - 2 * xy * s11 - 6 * xz * s12 + (4 * zz - 3 * xx - yy) * s13 + 2 * xz * s14 + 3 * (xx - yy) * s15;
        d[1] += 3 * (xx - yy) * s9 + xz * s10 + (4 * zz - xx - 3 * yy) * s11 - 6 * yz * s12 - 2 * xy * s13 - 2 * yz * s14 - 6 * xy * s15;
        d[2] += xy * s10 + 8 * yz * s11 + (6 * zz - 3 * xx - 3 * yy) * s12 + 8 * xz * s13 + (xx - yy) * s14;
    }
}

template <class T>
E4DGS_HD void view_direction(const Camera<T>& cam, const T* position, T* unit, T& inverse_length) {
    const T x = position[0] - cam.centre[0], y = position[1] - cam.centre[1], z = position[2] - cam.centre[2];
    inverse_length = T(1) / sqrt(x * x + y * y + z * z);
    unit[0] = x * inverse_length, unit[1] = y * inverse_length, unit[2] = z * inverse_length;
}

// color [3] from the basis B [(D+1)^2] and sh [(D+1)^2][3].
template <int D, class T>
E4DGS_HD void sh_color(const T* B, const T* sh, T* color) {
    for (int c = 0; c < 3; ++c) {
        T sum = T(0.5);
        for (int k = 0; k < (D + 1) * (D + 1); ++k) sum += B[k] * sh[3 * k + c];
        color[c] = sum > T(0) ? sum : T(0);
    }
}

// From dcolor [3]: writes dsh [(D+1)^2][3] (may be null) and dunit [3], the gradient of the unit direction (x, y, z) as a free vector.
template <int D, class T>
E4DGS_HD void sh_color_backward(T x, T y, T z, const T* sh, const T* dcolor, T* dsh, T* dunit) {
    constexpr int K = (D + 1) * (D + 1);
    T B[K], s[K], color[3];
    sh_basis<D>(x, y, z, B);
    sh_color<D>(B, sh, color);
    for (int k = 0; k < K; ++k) {
        s[k] = T(0);
        for (int c = 0; c < 3; ++c) {
            const T g = color[c] > T(0) ? dcolor[c] : T(0);
            s[k] += g * sh[3 * k + c];
            if (dsh) dsh[3 * k + c] = B[k] * g;
        }
    }
    sh_basis_backward<D>(x, y, z, s, dunit);
}

}  // namespace e4dgs
