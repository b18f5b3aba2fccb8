// Bilinear look-up on the three space planes, linear look-up on the three lines (the time planes interpolated at one time), their product, and
// the backward pass. C is the number of channels, or 0 if only field.channels has it. Included by field.inl.

constexpr int kAxisA[3] = {0, 0, 1};  // xy, xz, yz
constexpr int kAxisB[3] = {1, 2, 2};

// A point's place among `count` samples along each axis, whose ends are at the faces of the box. Points outside are clamped; NaN counts as low.
inline Taps taps_of(const Field& field, const float* point, int count) {
    Taps taps;
    for (int axis = 0; axis < 3; ++axis) {
        const float u = (point[axis] - field.low[axis]) * field.inverse_size[axis];
        float x = u > 0.0f ? u : 0.0f;
        x = (x < 1.0f ? x : 1.0f) * float(count - 1);
        const int last = count > 1 ? count - 2 : 0, low = int(x) < last ? int(x) : last;
        taps.low[axis] = low;
        taps.fraction[axis] = x - float(low);
    }
    return taps;
}

struct Bilinear {
    int64_t at[4];
    float weight[4];
};

inline Bilinear bilinear(const Taps& taps, int plane, int resolution) {
    const int a = kAxisA[plane], b = kAxisB[plane];
    const float fa = taps.fraction[a], fb = taps.fraction[b];
    const int next = resolution > 1;
    const int64_t low = int64_t(taps.low[b]) * resolution + taps.low[a], high = low + int64_t(next) * resolution;
    return {{low, low + next, high, high + next},
            {(1 - fa) * (1 - fb), fa * (1 - fb), (1 - fa) * fb, fa * fb}};
}

// Calls f(c) for whole vectors of channels and g(c) for the single channels that remain.
template <int C, class F, class G>
inline void for_channels(int channels, F&& f, G&& g) {
    const int count = C ? C : channels;
    int c = 0;
    for (; c + kWidth <= count; c += kWidth) f(c);
    for (; c < count; ++c) g(c);
}

// The values [6, C] of one point at one level, and their product.
template <int C>
inline void features_of_level(const Field& field, int l, const Taps& taps, float* values, float* product) {
    const Level& level = field.level[l];
    const int channels = C ? C : field.channels, r = level.resolution;
    const float* corner[3][4];
    const float* end[3][2];
    float weight[3][4];
    for (int plane = 0; plane < 3; ++plane) {
        const Bilinear b = bilinear(taps, plane, r);
        for (int k = 0; k < 4; ++k) {
            corner[plane][k] = level.space + (int64_t(plane) * r * r + b.at[k]) * channels;
            weight[plane][k] = b.weight[k];
        }
        end[plane][0] = level.lines + (int64_t(plane) * r + taps.low[plane]) * channels;
        end[plane][1] = end[plane][0] + (r > 1) * channels;
    }
    const auto at = [&](auto read, auto write, int c) {
        decltype(read(end[0][0])) v[6];
        for (int k = 0; k < 3; ++k) {
            const float *w = weight[k], f = taps.fraction[k];
            v[k] = w[0] * read(corner[k][0] + c) + w[1] * read(corner[k][1] + c) + w[2] * read(corner[k][2] + c) + w[3] * read(corner[k][3] + c);
            v[3 + k] = (1 - f) * read(end[k][0] + c) + f * read(end[k][1] + c);
        }
        for (int k = 0; k < 6; ++k) write(values + k * channels + c, v[k]);
        write(product + c, ((v[0] * v[1]) * v[2]) * ((v[3] * v[4]) * v[5]));
    };
    for_channels<C>(
        channels, [&](int c) { at([](const float* p) { return load(p); }, [](float* p, Vec v) { store(p, v); }, c); },
        [&](int c) { at([](const float* p) { return *p; }, [](float* p, float v) { *p = v; }, c); });
}

// The product rule with products from the left and from the right, so that nothing is divided by a value that may be zero. d_values: the six rows
// of one point, kChunk rows apart.
template <int C>
inline void product_backward(const Field& field, const float* values, const float* grad, float* d_values) {
    const int channels = C ? C : field.channels;
    const auto at = [&](auto read, auto write, int c) {
        decltype(read(grad)) v[6], right[6], left = read(grad + c);
        for (int k = 0; k < 6; ++k) v[k] = read(values + k * channels + c);
        right[5] = v[0] - v[0] + 1.0f;
        for (int k = 4; k >= 0; --k) right[k] = right[k + 1] * v[k + 1];
        for (int k = 0; k < 6; ++k) {
            write(d_values + k * kChunk * channels + c, left * right[k]);
            left = left * v[k];
        }
    };
    for_channels<C>(
        channels, [&](int c) { at([](const float* p) { return load(p); }, [](float* p, Vec v) { store(p, v); }, c); },
        [&](int c) { at([](const float* p) { return *p; }, [](float* p, float v) { *p = v; }, c); });
}

// grad: the gradient of the level's whole space planes [3, R, R, C] or lines [3, R, C].
template <int C>
void scatter(const Field& field, int l, int plane, const Taps* all_taps, int64_t n, const float* d_values, float* grad) {
    const int channels = C ? C : field.channels, r = field.level[l].resolution;
    for (int64_t i = 0; i < n; ++i) {
        const Taps& taps = all_taps[i];
        const float* d = d_values + i * channels;
        float* to[4];
        float weight[4];
        int count = 4;
        if (plane < 3) {
            const Bilinear b = bilinear(taps, plane, r);
            for (int k = 0; k < 4; ++k) to[k] = grad + (int64_t(plane) * r * r + b.at[k]) * channels, weight[k] = b.weight[k];
        } else {
            count = 2;
            const int axis = plane - 3;
            to[0] = grad + (int64_t(axis) * r + taps.low[axis]) * channels, weight[0] = 1 - taps.fraction[axis];
            to[1] = to[0] + (r > 1) * channels, weight[1] = taps.fraction[axis];
        }
        for (int k = 0; k < count; ++k)  // one after another: with a single sample, several taps are the same place
            for_channels<C>(
                channels, [&](int c) { store(to[k] + c, load(to[k] + c) + weight[k] * load(d + c)); }, [&](int c) { to[k][c] += weight[k] * d[c]; });
    }
}
