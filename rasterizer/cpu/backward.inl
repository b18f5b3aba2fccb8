// The backward pass of a tile, from the last blended primitive to the first. Each pixel keeps its transmittance T, which is restored by
// dividing by (1 - alpha), and `behind`, the contribution of everything behind to the gradient. With f = dL/dw of a layer,
// dL/dalpha = T f - behind / (1 - alpha). Included by blend.inl.

template <bool DEPTH, bool EXTRAS>
void backward_tile_impl(const BackwardJob& job, int tile, float* scratch) {
    const int x0 = tile % job.tiles_x * kTile, y0 = tile / job.tiles_x * kTile, extras = job.extras;
    float* extra = scratch;                       // [extras, kPixels]
    float* extra_sums = scratch + kPixels * extras;   // [extras, 16]
    TileGrads px;
    const Walk walk{&px, extra, extra_sums, extras};
    alignas(64) int32_t block_last[16], tile_last = -1;
    double background[3] = {0, 0, 0};
    for (int& last : block_last) last = -1;
    for (int i = 0; i < kPixels; ++i) {
        const int b = i / 16, x = x0 + b % kSide * 4 + i % 4, y = y0 + b / kSide * 4 + i % 16 / 4;
        px.transmittance[i] = px.behind[i] = px.red[i] = px.green[i] = px.blue[i] = px.z[i] = px.depth[i] = 0.0f;
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
        if (DEPTH && job.alpha[at] > 0.0f) px.z[i] = job.grad_depth[at] / job.alpha[at], px.depth[i] = job.depth[at];
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
    for (int32_t index = tile_last; index >= 0; --index) {
        if (index >= 8 && job.masks[begin + index - 8]) {
            const Entry& soon = job.entries[begin + index - 8];
            prefetch(job, soon.primitive);
            const char* to = reinterpret_cast<const char*>(job.slots + (uint64_t(soon.slot) << 2));
            for (int at = 0; at < (soon.primitive < job.n_gaussians ? 64 : 128); at += 64) __builtin_prefetch(to + at, 1);
        }
        uint32_t open = 0;  // blocks in which some pixel reaches this layer
        for (int k = 0; k < 16; k += kWidth) open |= bits(load(block_last + k) >= set1(index)) << k;
        const uint32_t mask = job.masks[begin + index] & open;
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
            gaussian_layer<DEPTH, EXTRAS>(walk, item, index, mask, out);
            for (int i = 0; i < 10; ++i) slot[i] = out[i];
            slot += 10;
        } else {
            convex_layer<DEPTH, EXTRAS>(walk, item, convex, job.points, index, mask, out);
            const ConvexRecord& record = job.convexes[entry.primitive - job.n_gaussians];
            const double dx = x0 + 0.5 - record.x0, dy = y0 + 0.5 - record.y0;  // from the tile's first pixel to the convex's centre
            for (int i = 0; i < kConvexEdges; ++i) slot[i] = out[i];
            slot += kConvexEdges;
            for (int i = 0; i < convex.n; ++i, slot += 3) {
                const float* edge = out + kConvexEdges + 3 * i;
                slot[0] = float(edge[0] + dx * edge[2]), slot[1] = float(edge[1] + dy * edge[2]), slot[2] = edge[2];
            }
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
