// Backward: the tile's primitives from the last blended one to the first. Each pixel carries its transmittance T, divided back
// by (1 - alpha), and `behind`, the gradient's share of everything behind; with f = dL/dw of a layer,
// dL/dalpha = T f - behind / (1 - alpha). Included by blend.inl.

struct TileGrads {  // in the order of TilePixels
    alignas(64) float transmittance[kPixels], behind[kPixels];
    alignas(64) float red[kPixels], green[kPixels], blue[kPixels], z[kPixels];
    alignas(64) int32_t last[kPixels];
};

// What both kinds share at one vector of pixels. g: dL/dalpha alpha where alpha is not capped.
template <bool DEPTH, bool EXTRAS>
inline Float layer_backward(TileGrads& px, const float* extra, float* extra_sums, int extras, int at, const Item& item, int32_t index, Float raw,
                            Mask counted, Float* sums) {
    const Mask live = counted & (load(px.last + at) >= set1(index));
    const Float alpha = keep(live, min(raw, set1(kMaxAlpha)));
    const Float inverse = reciprocal(set1(1.0f) - alpha);
    const Float before = load(px.transmittance + at) * inverse, behind = load(px.behind + at);
    const Float w = before * alpha;
    const Float red = load(px.red + at), green = load(px.green + at), blue = load(px.blue + at);
    Float f = fma(red, set1(item.color[0]), fma(green, set1(item.color[1]), blue * set1(item.color[2])));
    sums[0] = fma(w, red, sums[0]);
    sums[1] = fma(w, green, sums[1]);
    sums[2] = fma(w, blue, sums[2]);
    if constexpr (DEPTH) {
        const Float z = load(px.z + at);
        f = fma(z, set1(item.z), f);
        sums[3] = fma(w, z, sums[3]);
    }
    if constexpr (EXTRAS)
        for (int e = 0; e < extras; ++e) {
            const Float g = load(extra + kPixels * e + at);
            if (item.extras) f = fma(g, set1(item.extras[e]), f);
            float* sum = extra_sums + 16 * e;
            store(sum, fma(w, g, load(sum)));
        }
    store(px.transmittance + at, before);
    store(px.behind + at, fma(w, f, behind));
    return keep(raw < set1(kMaxAlpha), alpha * fnma(behind, inverse, before * f));
}

// Unrolled: the compiler's own idea, a string instruction, takes longer to start than to run.
template <int N>
__attribute__((always_inline)) inline void clear(Float* v) {
#pragma GCC unroll 32
    for (int i = 0; i < N; ++i) v[i] = zero();
}

// Adds one vector of pixels to a convex's sums: h = -dL/d(ln E) with E = 2^(rho lse), shared among the edges by their softmax. The
// third, h (lse - sum_i p_i L_i), is what tau's gradient consists of: from the other sums it would be a small difference of large numbers.
template <int N>
__attribute__((always_inline)) inline void edge_moments(const ConvexValue<N>& value, Float g, Float X, Float Y, Float* sums, Float* moments) {
    const Float h = g * value.outside, share = h * reciprocal(value.sum);
    sums[4] = sums[4] + g;
    sums[5] = fma(h, value.lse, sums[5]);
    Float spread = fma(h, value.spread, sums[6]);
    for (int e = 0; e < N; ++e) {
        const Float p = share * value.edge[e];
        spread = fnma(p, value.relative[e], spread);
        moments[3 * e] = fma(p, X, moments[3 * e]);
        moments[3 * e + 1] = fma(p, Y, moments[3 * e + 1]);
        moments[3 * e + 2] = moments[3 * e + 2] + p;
    }
    sums[6] = spread;
}

template <bool DEPTH, bool EXTRAS>
void backward_tile_impl(const BackwardJob& job, int tile, float* scratch) {
    const int x0 = tile % job.tiles_x * kTile, y0 = tile / job.tiles_x * kTile, extras = job.extras;
    float* extra = scratch;                       // [extras, kPixels]
    float* extra_sums = scratch + kPixels * extras;   // [extras, 16]
    TileGrads px;
    int32_t block_last[kBlocks], tile_last = -1;
    double background[3] = {0, 0, 0};
    for (int b = 0; b < kBlocks; ++b) block_last[b] = -1;
    for (int i = 0; i < kPixels; ++i) {
        const int b = i / 16, x = x0 + b % kSide * 4 + i % 4, y = y0 + b / kSide * 4 + i % 16 / 4;
        px.transmittance[i] = px.behind[i] = px.red[i] = px.green[i] = px.blue[i] = px.z[i] = 0.0f;
        px.last[i] = -1;
        if (EXTRAS)
            for (int e = 0; e < extras; ++e) extra[kPixels * e + i] = 0.0f;
        if (x >= job.width || y >= job.height) continue;
        const int64_t at = int64_t(y) * job.width + x;
        const float t = job.transmittance[at];
        float through = 0.0f;  // dL/dT of the light that passes all layers
        if (job.grad_color) {
            px.red[i] = job.grad_color[3 * at], px.green[i] = job.grad_color[3 * at + 1], px.blue[i] = job.grad_color[3 * at + 2];
            through += px.red[i] * job.background[0] + px.green[i] * job.background[1] + px.blue[i] * job.background[2];
            background[0] += double(px.red[i]) * t, background[1] += double(px.green[i]) * t, background[2] += double(px.blue[i]) * t;
        }
        if (job.grad_alpha) through -= job.grad_alpha[at];
        if (DEPTH && job.alpha[at] > 0.0f) {  // depth = sum w z / alpha
            px.z[i] = job.grad_depth[at] / job.alpha[at];
            through += px.z[i] * job.depth[at];
        }
        if (EXTRAS && job.grad_extras)
            for (int e = 0; e < extras; ++e) extra[kPixels * e + i] = job.grad_extras[at * extras + e];
        px.transmittance[i] = t;
        px.behind[i] = t * through;
        px.last[i] = job.last[at];
        if (px.last[i] > block_last[b]) block_last[b] = px.last[i];
        if (px.last[i] > tile_last) tile_last = px.last[i];
    }
    if (job.grad_background)
        for (int c = 0; c < 3; ++c) job.grad_background[3 * tile + c] = background[c];

    const uint64_t begin = job.tile_begin[tile];
    uint32_t active = 0;
    for (int32_t index = tile_last; index >= 0; --index) {
        if (index == tile_last || index % 32 == 31) {  // lanes are compared one by one; this only spares whole blocks
            active = 0;
            for (int b = 0; b < kBlocks; ++b) active |= uint32_t(block_last[b] >= (index & ~31)) << b;
        }
        if (index >= 8 && job.masks[begin + index - 8]) prefetch(job, job.entries[begin + index - 8].primitive);
        uint32_t mask = job.masks[begin + index] & active;
        if (!mask) continue;
        const Entry entry = job.entries[begin + index];
        Item item;
        ConvexItem convex;
        int n_convexes = 0;
        gather(job, entry.primitive, x0 + 0.5, y0 + 0.5, item, &convex, n_convexes);
        if (EXTRAS)
            for (int e = 0; e < 16 * extras; ++e) extra_sums[e] = 0.0f;
        float* slot = job.slots + (uint64_t(entry.slot) << 2);
        job.touched[entry.slot] = 1;
        alignas(64) float out[32];

        if (item.convex < 0) {
            Float sums[10] = {zero(), zero(), zero(), zero(), zero(), zero(), zero(), zero(), zero(), zero()};
            for (; mask; mask &= mask - 1) {
                const int b = __builtin_ctz(mask);
                for (int k = 0; k < kVectors; ++k) {
                    const Float X = load(kLaneX + k * kWidth) + set1(float(b % kSide * kBlock));
                    const Float Y = load(kLaneY + k * kWidth) + set1(float(b / kSide * kBlock));
                    Mask counted;
                    Float u, v;
                    const Float raw = gaussian_alpha(item, X, Y, u, v, counted);
                    const Float g = layer_backward<DEPTH, EXTRAS>(px, extra, extra_sums, extras, 16 * b + k * kWidth, item, index, raw, counted, sums);
                    const Float gu = g * u, gv = g * v;
                    sums[4] = sums[4] + g;
                    sums[5] = sums[5] + gu;
                    sums[6] = sums[6] + gv;
                    sums[7] = fma(gu, u, sums[7]);
                    sums[8] = fma(gu, v, sums[8]);
                    sums[9] = fma(gv, v, sums[9]);
                }
            }
            sum_lanes<10>(sums, out);
            for (int i = 0; i < 10; ++i) slot[i] = out[i];
            slot += 10;
        } else {
            const int n = convex.n;
            const ConvexRecord& record = job.convexes[entry.primitive - job.n_gaussians];
            Float sums[32];
            clear<32>(sums);
            convex_blocks(convex, job.points, mask);
            const auto inside_block = [&](int b) {
                for (int k = 0; k < kVectors; ++k)
                    sums[4] = sums[4] + layer_backward<DEPTH, EXTRAS>(px, extra, extra_sums, extras, 16 * b + k * kWidth, item, index,
                                                                      set1(convex.opacity), all(), sums);
            };
            if (convex.gentle) {
                for_count(job.points, [&](auto count) {
                    Float moments[3 * count.value];
                    clear<3 * count.value>(moments);
                    for (uint32_t m = mask; m; m &= m - 1) {
                        const int b = __builtin_ctz(m);
                        if (convex.inside >> b & 1) {
                            inside_block(b);
                            continue;
                        }
                        for (int k = 0; k < kVectors; ++k) {
                            const Float X = load(kLaneX + k * kWidth) + set1(float(b % kSide * kBlock));
                            const Float Y = load(kLaneY + k * kWidth) + set1(float(b / kSide * kBlock));
                            Mask counted;
                            ConvexValue<count.value> value;
                            const Float raw = gentle_alpha(convex, b, k * kWidth, value, counted);
                            const Float g =
                                layer_backward<DEPTH, EXTRAS>(px, extra, extra_sums, extras, 16 * b + k * kWidth, item, index, raw, counted, sums);
                            edge_moments(value, g, X, Y, sums, moments);
                        }
                    }
#pragma GCC unroll 32
                    for (int i = 0; i < 3 * count.value; ++i) sums[kConvexEdges + i] = moments[i];
                });
            } else {
                Edges edges;
                for (; mask; mask &= mask - 1) {
                    const int b = __builtin_ctz(mask);
                    if (convex.inside >> b & 1) {
                        inside_block(b);
                        continue;
                    }
                    select_edges(convex, b, edges);
                    for_count(edges.n, [&](auto count) {
                        Float moments[3 * count.value];
                        clear<3 * count.value>(moments);
                        for (int k = 0; k < kVectors; ++k) {
                            const Float X = load(kLaneX + k * kWidth) + set1(float(b % kSide * kBlock));
                            const Float Y = load(kLaneY + k * kWidth) + set1(float(b / kSide * kBlock));
                            Mask counted;
                            ConvexValue<count.value> value;
                            const Float raw = convex_alpha(convex, edges, X, Y, value, counted);
                            const Float g =
                                layer_backward<DEPTH, EXTRAS>(px, extra, extra_sums, extras, 16 * b + k * kWidth, item, index, raw, counted, sums);
                            edge_moments(value, g, X, Y, sums, moments);
                        }
                        for (int e = 0; e < count.value; ++e)
                            for (int j = 0; j < 3; ++j) {
                                Float& to = sums[kConvexEdges + 3 * edges.index[e] + j];
                                to = to + moments[3 * e + j];
                            }
                    });
                }
            }
            sum_lanes<16>(sums, out);
            if (kConvexEdges + 3 * n > 16) sum_lanes<16>(sums + 16, out + 16);
            for (int i = 0; i < kConvexEdges; ++i) slot[i] = out[i];
            for (int i = 0; i < n; ++i) {  // from the tile's first pixel to the convex's centre
                const double p = out[kConvexEdges + 3 * i + 2];
                float* to = slot + kConvexEdges + 3 * i;
                to[0] = float(out[kConvexEdges + 3 * i] + (x0 + 0.5 - record.x0) * p);
                to[1] = float(out[kConvexEdges + 3 * i + 1] + (y0 + 0.5 - record.y0) * p);
                to[2] = float(p);
            }
            slot += kConvexEdges + 3 * n;
        }
        if (EXTRAS)
            for (int e = 0; e < extras; ++e) {
                const float* s = extra_sums + 16 * e;
                float sum = 0.0f;
                for (int l = 0; l < kWidth; ++l) sum += s[l];
                slot[e] = sum;
            }
    }
}

void backward_tile(const BackwardJob& job, int tile, float* scratch) {
    const bool extras = job.extras && job.grad_extras;
    if (job.grad_depth)
        extras ? backward_tile_impl<true, true>(job, tile, scratch) : backward_tile_impl<true, false>(job, tile, scratch);
    else
        extras ? backward_tile_impl<false, true>(job, tile, scratch) : backward_tile_impl<false, false>(job, tile, scratch);
}
