// The gradients of the extras alone: for each layer, the sums over its pixels of its blending weight times the gradients of the channels.
// They do not depend on what lies behind a layer, so nothing else is summed. The order is that of backward.inl, so that not a bit depends on
// what else is asked for. Included by blend.inl.

struct Weights {
    alignas(64) float transmittance[kPixels];  // behind the layer
    alignas(64) int32_t last[kPixels];
};

// N: number of channels. extra [N, kPixels]: their gradients. sums [N].
template <int N>
__attribute__((noinline)) void attributed_layer(Weights& px, const float* extra, const Item& item, const ConvexItem& convex, int points, int32_t index,
                                                uint32_t mask, Float* sums) {
    clear<N>(sums);
    const uint32_t first = item.convex < 0 ? mask : mask & convex.inside;  // convex_layer() has these blocks first
    const uint32_t parts[2] = {first, mask & ~first};
    for (uint32_t left : parts)
        for (; left; left &= left - 1) {
            const int b = __builtin_ctz(left);
            Float X[kVectors], Y[kVectors], raws[kVectors], u, v;
            Mask counts[kVectors];
            for (int k = 0; k < kVectors; ++k) {
                X[k] = load(kLaneX + k * kWidth) + set1(float(b % kSide * kBlock));
                Y[k] = load(kLaneY + k * kWidth) + set1(float(b / kSide * kBlock));
                if (item.convex < 0) raws[k] = gaussian_alpha(item, X[k], Y[k], u, v, counts[k]);
            }
            if (item.convex >= 0) convex_alphas(convex, points, b, X, Y, raws, counts);
            for (int k = 0; k < kVectors; ++k) {
                const int at = 16 * b + k * kWidth;
                const Mask live = counts[k] & (load(px.last + at) >= set1(index));
                const Float alpha = keep(live, min(raws[k], set1(kMaxAlpha)));
                const Float before = load(px.transmittance + at) * reciprocal(set1(1.0f) - alpha), w = before * alpha;
                store(px.transmittance + at, before);
                for (int e = 0; e < N; ++e) sums[e] = fma(w, load(extra + kPixels * e + at), sums[e]);
            }
        }
}

// Writes the sums to the beginning of each slot.
void attribute_tile(const BackwardJob& job, int tile, float* extra) {
    const int x0 = tile % job.tiles_x * kTile, y0 = tile / job.tiles_x * kTile, extras = job.extras;
    Weights px;
    alignas(64) int32_t block_last[16], tile_last = -1;
    for (int& last : block_last) last = -1;
    for (int i = 0; i < kPixels; ++i) {
        const int b = i / 16, x = x0 + b % kSide * 4 + i % 4, y = y0 + b / kSide * 4 + i % 16 / 4;
        const bool inside = x < job.width && y < job.height;
        const int64_t at = int64_t(y) * job.width + x;
        px.transmittance[i] = inside ? job.transmittance[at] : 0.0f;
        px.last[i] = inside ? job.last[at] : -1;
        for (int e = 0; e < extras; ++e) extra[kPixels * e + i] = inside ? job.grad_extras[at * extras + e] : 0.0f;
        if (px.last[i] > block_last[b]) block_last[b] = px.last[i];
        if (px.last[i] > tile_last) tile_last = px.last[i];
    }
    const uint64_t begin = job.tile_begin[tile];
    for (int32_t index = tile_last; index >= 0; --index) {
        if (index >= 8 && job.masks[begin + index - 8]) prefetch(job, job.entries[begin + index - 8].primitive);
        uint32_t open = 0;  // blocks in which some pixel reaches this layer
        for (int k = 0; k < 16; k += kWidth) open |= bits(load(block_last + k) >= set1(index)) << k;
        const uint32_t mask = job.masks[begin + index] & open;
        if (!mask) continue;
        const Entry entry = job.entries[begin + index];
        Item item;
        ConvexItem convex;
        int n_convexes = 0;
        gather(job, entry.primitive, x0 + 0.5, y0 + 0.5, item, &convex, n_convexes);
        if (item.convex >= 0) convex_blocks(convex, job.points, mask);
        Float sums[kMostAttributed];
        for_count(extras, [&](auto count) { attributed_layer<count.value>(px, extra, item, convex, job.points, index, mask, sums); });
        float* slot = job.slots + (uint64_t(entry.slot) << 2);
        job.touched[entry.slot] = 1;
        for (int e = 0; e < extras; ++e) {
            alignas(64) float lanes[16];
            store(lanes, sums[e]);
            slot[e] = 0.0f;
            for (int l = 0; l < kWidth; ++l) slot[e] += lanes[l];
        }
    }
}
