// The alpha of a Gaussian at a vector of pixels, and which blocks of a tile it may touch. Included by blend.inl.

// Blocks whose pixel centres may intersect the disc u^2 + v^2 <= radius^2, tested with three separating axes: the block's own two edges and
// the line from the disc's centre to the block's centre. A block is a parallelogram in the (u, v) plane.
inline uint32_t gaussian_blocks(const Item& g, float radius) {
    constexpr float h = 0.5f * (kBlock - 1);
    const float r = radius + 1e-4f;
    const float side = __builtin_sqrtf(g.f1 * g.f1 + g.f2 * g.f2);
    const Float f0 = set1(g.f0), f1 = set1(g.f1), f2 = set1(g.f2), r2 = set1(r * r), half = set1(h);
    const Float high_v = set1(r + h * g.f2), high_n = set1(r * side + h * g.f0 * g.f2);
    uint32_t mask = 0;
    for (int k = 0; k < kVectors; ++k) {
        const Float y = load(kCentres.y + k * kWidth);
        const Float u = fma(f0, load(kCentres.x + k * kWidth), fma(f1, y, set1(g.u))), v = fma(f2, y, set1(g.v));
        const Float p2 = fma(u, u, v * v);
        const Float support = fma(abs(u), f0, abs(fma(u, f1, v * f2)));
        const Float gap = max(fnma(half, support, p2), zero());
        const Mask m = (high_v >= abs(v)) & (high_n >= abs(fma(u, f2, zero() - v * f1))) & (r2 * p2 >= gap * gap);
        mask |= bits(m) << (k * kWidth);
    }
    return mask & kAllBlocks;
}

// alpha before the cap. `counted` is true where alpha is at least 1/255; elsewhere the returned value is meaningless.
inline Float gaussian_alpha(const Item& g, Float X, Float Y, Float& u, Float& v, Mask& counted) {
    u = fma(set1(g.f0), X, fma(set1(g.f1), Y, set1(g.u)));
    v = fma(set1(g.f2), Y, set1(g.v));
    const Float e = fnma(u, u, fnma(v, v, set1(g.exponent)));
    counted = e >= set1(float(kLog2MinAlpha));
    return exp2<false>(e);
}
