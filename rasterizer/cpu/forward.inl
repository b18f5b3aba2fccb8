// Forward: a chunk of the tile's primitives is gathered and sorted into lists, one a block; then each block that still lets
// light through walks its list with its pixels in registers. Included by blend.inl.

struct TilePixels {  // lane l of block b is pixel (4 (b % 4) + l % 4, 4 (b / 4) + l / 4)
    alignas(64) float falling[256];        // transmittance as if nothing stopped: below the line, the pixel has stopped
    alignas(64) float transmittance[256];  // behind the last blended layer
    alignas(64) float red[256], green[256], blue[256], z[256], weight[256];
    alignas(64) int32_t last[256];
};

template <bool EXTRAS>
inline bool forward_block(TilePixels& px, float* extra, int extras, int b, const Item* items, const ConvexItem* convexes,
                          const uint8_t* list, int n, int32_t first, uint8_t* seen) {
    Float falling[kVectors], transmittance[kVectors], red[kVectors], green[kVectors], blue[kVectors], z[kVectors], weight[kVectors];
    Int last[kVectors];
    Float X[kVectors], Y[kVectors];
    for (int k = 0; k < kVectors; ++k) {
        const int at = 16 * b + k * kWidth;
        falling[k] = load(px.falling + at), transmittance[k] = load(px.transmittance + at), last[k] = load(px.last + at);
        red[k] = load(px.red + at), green[k] = load(px.green + at), blue[k] = load(px.blue + at);
        z[k] = load(px.z + at), weight[k] = load(px.weight + at);
        X[k] = load(kLaneX + k * kWidth) + set1(float(b % 4 * kBlock));
        Y[k] = load(kLaneY + k * kWidth) + set1(float(b / 4 * kBlock));
    }
    bool alive = true;
    for (int i = 0; i < n && alive; ++i) {
        const int j = list[i];
        const Item& item = items[j];
        seen[j] = 1;
        alive = false;
        Float raws[kVectors];
        Mask counts[kVectors];
        if (item.convex < 0) {
            Float u, v;
            for (int k = 0; k < kVectors; ++k) raws[k] = gaussian_alpha(item, X[k], Y[k], u, v, counts[k]);
        } else if (const ConvexItem& convex = convexes[item.convex]; convex.inside >> b & 1) {
            for (int k = 0; k < kVectors; ++k) raws[k] = set1(convex.opacity), counts[k] = all();
        } else {
            Edges edges;
            select_edges(convex, b, edges);
            for_count(edges.n, [&](auto count) {
                ConvexValue<count.value> value;
                for (int k = 0; k < kVectors; ++k) raws[k] = convex_alpha(convex, edges, X[k], Y[k], value, counts[k]);
            });
        }
        for (int k = 0; k < kVectors; ++k) {
            const Float alpha = keep(counts[k], min(raws[k], set1(kMaxAlpha)));
            const Float before = falling[k];
            falling[k] = fnma(before, alpha, before);
            const Mask on = falling[k] >= set1(kMinTransmittance);
            const Float w = keep(on, before * alpha);
            transmittance[k] = select(on, falling[k], transmittance[k]);
            last[k] = select(on, set1(first + j), last[k]);
            red[k] = fma(w, set1(item.color[0]), red[k]);
            green[k] = fma(w, set1(item.color[1]), green[k]);
            blue[k] = fma(w, set1(item.color[2]), blue[k]);
            z[k] = fma(w, set1(item.z), z[k]);
            weight[k] = weight[k] + w;
            if (EXTRAS && item.extras)
                for (int e = 0; e < extras; ++e) {
                    float* p = extra + 256 * e + 16 * b + k * kWidth;
                    store(p, fma(w, set1(item.extras[e]), load(p)));
                }
            alive |= any(on);
        }
    }
    for (int k = 0; k < kVectors; ++k) {
        const int at = 16 * b + k * kWidth;
        store(px.falling + at, falling[k]), store(px.transmittance + at, transmittance[k]), store(px.last + at, last[k]);
        store(px.red + at, red[k]), store(px.green + at, green[k]), store(px.blue + at, blue[k]);
        store(px.z + at, z[k]), store(px.weight + at, weight[k]);
    }
    return alive;
}

inline void write_pixels(const ForwardJob& job, const TilePixels& px, const float* extra, int x0, int y0) {
    const int w = job.width - x0 < kTile ? job.width - x0 : kTile, h = job.height - y0 < kTile ? job.height - y0 : kTile;
    for (int y = 0; y < h; ++y)
        for (int x = 0; x < w; ++x) {
            const int at = 16 * (y / 4 * 4 + x / 4) + y % 4 * 4 + x % 4;
            const int64_t to = int64_t(y0 + y) * job.width + x0 + x;
            const float t = px.transmittance[at], a = px.weight[at];
            job.color[3 * to] = px.red[at] + t * job.background[0];
            job.color[3 * to + 1] = px.green[at] + t * job.background[1];
            job.color[3 * to + 2] = px.blue[at] + t * job.background[2];
            job.alpha[to] = a;
            job.depth[to] = a > 0.0f ? px.z[at] / a : 0.0f;
            for (int e = 0; e < job.extras; ++e) job.extra[to * job.extras + e] = extra[256 * e + at];
            if (job.transmittance) job.transmittance[to] = t, job.last[to] = px.last[at];
        }
}

template <bool EXTRAS>
void forward_tile_impl(const ForwardJob& job, int tile, float* extra) {
    const int x0 = tile % job.tiles_x * kTile, y0 = tile / job.tiles_x * kTile;
    TilePixels px;
    uint32_t alive = 0;
    for (int i = 0; i < 256; ++i) {
        const int b = i / 16, x = x0 + b % 4 * 4 + i % 4, y = y0 + b / 4 * 4 + i % 16 / 4;
        const bool inside = x < job.width && y < job.height;
        px.falling[i] = inside ? 1.0f : 0.0f;
        px.transmittance[i] = 1.0f;
        px.red[i] = px.green[i] = px.blue[i] = px.z[i] = px.weight[i] = 0.0f;
        px.last[i] = -1;
        alive |= uint32_t(inside) << b;
    }
    if (EXTRAS) __builtin_memset(extra, 0, sizeof(float) * 256 * job.extras);

    Item items[kChunk];
    ConvexItem convexes[kChunk];
    uint8_t lists[16][kChunk], seen[kChunk];
    const uint64_t begin = job.tile_begin[tile], end = job.tile_begin[tile + 1];
    for (uint64_t at = begin; at < end && alive; at += kChunk) {
        const int n = end - at < kChunk ? int(end - at) : kChunk;
        int counts[16] = {}, n_convexes = 0;
        for (int j = 0; j < n; ++j) {
            if (at + j + 8 < end) prefetch(job, job.entries[at + j + 8].primitive);
            const uint32_t id = job.entries[at + j].primitive;
            gather(job, id, x0 + 0.5, y0 + 0.5, items[j], convexes, n_convexes);
            const uint32_t mask = id < job.n_gaussians ? gaussian_blocks(items[j], job.gaussians[id].radius) : convex_blocks(convexes[items[j].convex]);
            job.masks[at + j] = uint16_t(mask);
            seen[j] = 0;
            for (uint32_t m = mask & alive; m; m &= m - 1) {
                const int b = __builtin_ctz(m);
                lists[b][counts[b]++] = uint8_t(j);
            }
        }
        for (uint32_t m = alive; m; m &= m - 1) {
            const int b = __builtin_ctz(m);
            if (counts[b] && !forward_block<EXTRAS>(px, extra, job.extras, b, items, convexes, lists[b], counts[b], int32_t(at - begin), seen))
                alive &= ~(1u << b);
        }
        for (int j = 0; j < n; ++j) {
            if (!seen[j]) continue;
            const uint32_t id = job.entries[at + j].primitive;
            // Several tiles may write the same 1.
            uint8_t* flag = id < job.n_gaussians ? job.visible_gaussians + id : job.visible_convexes + (id - job.n_gaussians);
            __atomic_store_n(flag, uint8_t(1), __ATOMIC_RELAXED);
        }
    }
    write_pixels(job, px, extra, x0, y0);
}

void forward_tile(const ForwardJob& job, int tile, float* scratch) {
    job.extras ? forward_tile_impl<true>(job, tile, scratch) : forward_tile_impl<false>(job, tile, scratch);
}
