// Colours of a vector of primitives from spherical harmonics, and back. Directions and the basis are Packs. The coefficients, which
// are most of the work, are processed row by row, as stored in memory. Included by project.inl.

template <int D>
struct ShBasis {
    static constexpr int K = (D + 1) * (D + 1);
    Pack unit[3], inverse_length;
    alignas(64) double values[K][kLanes];

    ShBasis(const Camera<Pack>& camera, const Pack* position) {
        Pack B[K];
        view_direction(camera, position, unit, inverse_length);
        sh_basis<D>(unit[0], unit[1], unit[2], B);
        for (int k = 0; k < K; ++k) store_lanes(B[k], values[k]);
    }

    // The colour before the clamp at 0.
    void colour(int lane, const float* sh, float* out) const {
        float red = 0.5f, green = 0.5f, blue = 0.5f;
        for (int k = 0; k < K; ++k) {
            const float b = float(values[k][lane]);
            red += b * sh[3 * k], green += b * sh[3 * k + 1], blue += b * sh[3 * k + 2];
        }
        out[0] = red, out[1] = green, out[2] = blue;
    }
};

template <int D>
void sh_colours(const Camera<Pack>& camera, const Pack* position, const float* sh, const int64_t* index, const bool* wanted, float (*out)[3]) {
    const ShBasis<D> basis(camera, position);
    for (int l = 0; l < kLanes; ++l) {
        if (!wanted[l]) continue;
        basis.colour(l, sh + index[l] * ShBasis<D>::K * 3, out[l]);
        for (int c = 0; c < 3; ++c) out[l][c] = out[l][c] > 0.0f ? out[l][c] : 0.0f;
    }
}

// dcolour [3][lanes]. Writes grad (may be null) for the lanes in `mine`; adds to dposition.
template <int D, class G>
void sh_colours_backward(const Camera<Pack>& camera, const Pack* position, const float* sh, const int64_t* index, const bool* mine,
                         const double (*dcolour)[kLanes], float* grad, Pack* dposition, G& camera_grad) {
    constexpr int K = ShBasis<D>::K;
    const ShBasis<D> basis(camera, position);
    alignas(64) double along_basis[K][kLanes];
    for (int l = 0; l < kLanes; ++l) {
        const float* row = sh + index[l] * K * 3;
        float colour[3], g[3];
        basis.colour(l, row, colour);
        for (int c = 0; c < 3; ++c) g[c] = colour[c] > 0.0f ? float(dcolour[c][l]) : 0.0f;  // no gradient through the clamp
        for (int k = 0; D > 0 && k < K; ++k) along_basis[k][l] = double(g[0] * row[3 * k] + g[1] * row[3 * k + 1] + g[2] * row[3 * k + 2]);
        if (!grad || !mine[l]) continue;
        float* to = grad + index[l] * K * 3;
        for (int k = 0; k < K; ++k) {
            const float b = float(basis.values[k][l]);
            to[3 * k] = b * g[0], to[3 * k + 1] = b * g[1], to[3 * k + 2] = b * g[2];
        }
    }
    if constexpr (D > 0) {
        Pack s[K], d[3], dcentre[3];
        for (int k = 0; k < K; ++k) s[k] = *reinterpret_cast<const Doubles*>(along_basis[k]);
        const Pack* unit = basis.unit;
        sh_basis_backward<D>(unit[0], unit[1], unit[2], s, d);
        const Pack along = unit[0] * d[0] + unit[1] * d[1] + unit[2] * d[2];
        for (int j = 0; j < 3; ++j) {
            const Pack dj = (d[j] - along * unit[j]) * basis.inverse_length;
            dposition[j] += dj;
            dcentre[j] = -dj;
        }
        centre_backward(camera, dcentre, camera_grad);
    }
}

inline void colours(const Looks& in, const Camera<Pack>& camera, const Pack* position, const int64_t* index, const bool* wanted, float (*out)[3]) {
    if (in.colors) {
        for (int l = 0; l < kLanes; ++l)
            for (int c = 0; c < 3; ++c) out[l][c] = in.colors[3 * index[l] + c];
        return;
    }
    switch (in.degree) {
        case 0: return sh_colours<0>(camera, position, in.sh, index, wanted, out);
        case 1: return sh_colours<1>(camera, position, in.sh, index, wanted, out);
        case 2: return sh_colours<2>(camera, position, in.sh, index, wanted, out);
        default: return sh_colours<3>(camera, position, in.sh, index, wanted, out);
    }
}

template <class G>
void colours_backward(const Looks& in, const LooksGrad& out, const Camera<Pack>& camera, const Pack* position, const int64_t* index,
                      const bool* mine, const double (*dcolour)[kLanes], Pack* dposition, G& grad) {
    if (in.colors) {
        for (int l = 0; out.colors && l < kLanes; ++l)
            for (int c = 0; mine[l] && c < 3; ++c) out.colors[3 * index[l] + c] = float(dcolour[c][l]);
        return;
    }
    switch (in.degree) {
        case 0: return sh_colours_backward<0>(camera, position, in.sh, index, mine, dcolour, out.sh, dposition, grad);
        case 1: return sh_colours_backward<1>(camera, position, in.sh, index, mine, dcolour, out.sh, dposition, grad);
        case 2: return sh_colours_backward<2>(camera, position, in.sh, index, mine, dcolour, out.sh, dposition, grad);
        default: return sh_colours_backward<3>(camera, position, in.sh, index, mine, dcolour, out.sh, dposition, grad);
    }
}
