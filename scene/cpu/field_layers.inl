// Layers of the perceptron on blocks of rows, forward and backward: one small matrix product with its sums in registers. All widths are
// padded to whole vectors, and row counts to multiples of kRows. Included by field.inl.

// acc[r][v] += sum_k a(r, k) b[k, columns of v], with a(r, k) = a[r * a_row + k * a_k].
template <int NV>
inline void multiply(const float* a, int64_t a_row, int64_t a_k, const float* b, int64_t b_k, int k_count, Vec (&acc)[kRows][NV]) {
    for (int k = 0; k < k_count; ++k) {
        Vec row[NV];
        for (int v = 0; v < NV; ++v) row[v] = load(b + k * b_k + v * kWidth);
        for (int r = 0; r < kRows; ++r) {
            const Vec x = all(a[r * a_row + k * a_k]);
            for (int v = 0; v < NV; ++v) acc[r][v] += x * row[v];
        }
    }
}

// Calls f(number of vectors as a constant, first column) over `columns`: for whole panels, then pairs, then single vectors.
template <int N>
struct Vectors {
    static constexpr int value = N;
};

template <class F>
inline void for_panels(int columns, F&& f) {
    int c = 0;
    for (; c + kPanel * kWidth <= columns; c += kPanel * kWidth) f(Vectors<kPanel>(), c);
    for (; c + 2 * kWidth <= columns; c += 2 * kWidth) f(Vectors<2>(), c);
    for (; c < columns; c += kWidth) f(Vectors<1>(), c);
}

inline Vec positive(Vec v) { return v > 0.0f ? v : Vec{}; }

// out [rows, n_out] = relu?(in [rows, n_in] w [n_in, n_out] + bias)
template <bool RELU>
void layer(const float* in, int n_in, int rows, const float* w, int n_out, int k_count, const float* bias, float* out) {
    for_panels(n_out, [&](auto vectors, int c) {
        for (int r = 0; r < rows; r += kRows) {
            Vec acc[kRows][vectors.value];
            for (int i = 0; i < kRows; ++i)
                for (int v = 0; v < vectors.value; ++v) acc[i][v] = load(bias + c + v * kWidth);
            multiply<vectors.value>(in + r * n_in, n_in, 1, w + c, n_out, k_count, acc);
            for (int i = 0; i < kRows; ++i)
                for (int v = 0; v < vectors.value; ++v) store(out + (r + i) * n_out + c + v * kWidth, RELU ? positive(acc[i][v]) : acc[i][v]);
        }
    });
}

// d_in [rows, n_in] = d_out [rows, n_out] w [n_out, n_in] where `active` (the layer's input, after its ReLU) is positive, else 0; everywhere if it is
// null. Only the first k_count of n_out are not padding.
inline void back(const float* d_out, int n_out, int k_count, int rows, const float* w, int n_in, const float* active, float* d_in) {
    for_panels(n_in, [&](auto vectors, int c) {
        for (int r = 0; r < rows; r += kRows) {
            Vec acc[kRows][vectors.value] = {};
            multiply<vectors.value>(d_out + r * n_out, n_out, 1, w + c, n_in, k_count, acc);
            for (int i = 0; i < kRows; ++i)
                for (int v = 0; v < vectors.value; ++v) {
                    const int64_t at = int64_t(r + i) * n_in + c + v * kWidth;
                    store(d_in + at, active ? (load(active + at) > 0.0f ? acc[i][v] : Vec{}) : acc[i][v]);
                }
        }
    });
}

inline void add_to(double* sums, Vec v) {
    typedef double Wide __attribute__((vector_size(8 * kWidth)));
    typedef double LooseWide __attribute__((vector_size(8 * kWidth), aligned(8)));
    LooseWide& to = *reinterpret_cast<LooseWide*>(sums);
    to = to + __builtin_convertvector(v, Wide);
}

// sums [n_out, n_in] += d_out^T in, for the first `used` rows; the others are padding. Sums are float within a block and double across blocks.
inline void add_products(const float* d_out, int n_out, int used, const float* in, int n_in, int rows, double* sums) {
    for_panels(n_in, [&](auto vectors, int c) {
        for (int o = 0; o < used; o += kRows) {
            Vec acc[kRows][vectors.value] = {};
            multiply<vectors.value>(d_out + o, 1, n_out, in + c, n_in, rows, acc);
            for (int i = 0; i < kRows; ++i) {
                double* to = sums + int64_t(o + i) * n_in + c;
                for (int v = 0; v < vectors.value; ++v) add_to(to + v * kWidth, acc[i][v]);
            }
        }
    });
}

inline void add_columns(const float* d_out, int n_out, int rows, double* sums) {
    for (int c = 0; c < n_out; c += kWidth) {
        Vec sum = {};
        for (int r = 0; r < rows; ++r) sum += load(d_out + r * n_out + c);
        add_to(sums + c, sum);
    }
}

// Addresses of the sums of each layer.
struct WeightGrads {
    double *w1, *b1, *w2, *b2, *w3, *b3;
    WeightGrads(const Field& field, double* at) {
        const int64_t f = field.features_padded(), w = field.width_padded(), o = field.outputs_padded();
        w1 = at, b1 = w1 + w * f, w2 = b1 + w, b2 = w2 + w * w, w3 = b2 + w, b3 = w3 + o * w;
    }
};
