// Exponential and logarithm of a vector of floats. Always inlined, because a call inside a loop over pixels would spill all its vectors.
// Included by blend.inl and project.inl.

// 2^f = 1 + f p(f) for |f| <= 1/2. The minimax polynomial of its degree: its relative error of 1e-7 is as large as that of rounding.
__attribute__((always_inline)) inline Float exp2_fraction(Float f) {
    const auto polynomial = [f](auto first, auto... rest) {
        Float p = set1(first);
        ((p = fma(p, f, set1(rest))), ...);
        return fma(p, f, set1(1.0f));
    };
    return polynomial(0.001326472731307149f, 0.009671512991189957f, 0.05550733581185341f, 0.24022242426872253f, 0.6931470036506653f);
}

// 2^a. If a is below the range of exponents: with SATURATE, (nearly) 0; otherwise any value, which callers mask out.
template <bool SATURATE = true>
__attribute__((always_inline)) inline Float exp2(Float a) {
    if constexpr (SATURATE && !kScaleSaturates) a = max(a, set1(-126.0f));
    const Float n = nearest(a);
    return scale(exp2_fraction(a - n), n);
}

// log2 a for normal a > 0, absolute error 1e-7 for small results.
__attribute__((always_inline)) inline Float log2(Float a) {
    Float e, m;
    split(a, e, m);
    const Mask high = m >= set1(1.41421356f);
    e = select(high, e + set1(1.0f), e);
    const Float t = select(high, m * set1(0.5f), m) - set1(1.0f);
    // Estrin's scheme: a chain of nine operations would stall the processor, whose window holds hardly two pixels' worth of instructions.
    const Float t2 = t * t, t4 = t2 * t2;
    const auto pair = [t](float a, float b) { return fma(set1(a), t, set1(b)); };
    const Float low = fma(fma(pair(-0.23851944506168365f, 0.28765666484832764f), t2, pair(-0.3607212007045746f, 0.48092252016067505f)), t2,
                          pair(-0.7213471531867981f, 1.442694902420044f));
    const Float high_part = fma(set1(0.12541235983371735f), t2, pair(-0.21030330657958984f, 0.2173794060945511f));
    return fma(fma(high_part, t4 * t2, low), t, e);
}
