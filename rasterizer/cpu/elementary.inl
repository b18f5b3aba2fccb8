// Exponential and logarithm of a vector of floats. Included by blend.inl and project.inl.

// 2^a, a relative error of 1e-7. Below the range of exponents 0 where SATURATE, else anything: callers mask that.
template <bool SATURATE = true>
inline Float exp2(Float a) {
    if constexpr (SATURATE && !kScaleSaturates) a = max(a, set1(-126.0f));
    const Float n = nearest(a), f = a - n;
    Float p = fma(set1(0.001326472731307149f), f, set1(0.009671512991189957f));
    p = fma(p, f, set1(0.05550733581185341f));
    p = fma(p, f, set1(0.24022242426872253f));
    p = fma(p, f, set1(0.6931470036506653f));
    return scale(fma(p, f, set1(1.0f)), n);
}

// log2 a for normal a > 0, absolute error 1e-7 for small results.
inline Float log2(Float a) {
    Float e, m;
    split(a, e, m);
    const Mask high = m >= set1(1.41421356f);
    e = select(high, e + set1(1.0f), e);
    const Float t = select(high, m * set1(0.5f), m) - set1(1.0f);
    Float p = fma(set1(0.12541235983371735f), t, set1(-0.21030330657958984f));
    p = fma(p, t, set1(0.2173794060945511f));
    p = fma(p, t, set1(-0.23851944506168365f));
    p = fma(p, t, set1(0.28765666484832764f));
    p = fma(p, t, set1(-0.3607212007045746f));
    p = fma(p, t, set1(0.48092252016067505f));
    p = fma(p, t, set1(-0.7213471531867981f));
    p = fma(p, t, set1(1.442694902420044f));
    return fma(p, t, e);
}
