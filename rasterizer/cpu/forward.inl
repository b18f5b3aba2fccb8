// The forward pass of a tile. A chunk of the tile's primitives is gathered and tested against its blocks. Then each block that still has
// unfinished pixels walks the primitives that may touch it, with its pixels in registers. Included by blend.inl.

struct TilePixels {  // lane l of block b is pixel (4 (b % kSide) + l % 4, 4 (b / kSide) + l / 4)
    alignas(64) float falling[kPixels];        // transmittance as if no pixel ever stopped; a pixel below the threshold has stopped
    alignas(64) float transmittance[kPixels];  // for stopped pixels: behind their last blended layer
    alignas(64) float red[kPixels], green[kPixels], blue[kPixels], z[kPixels], weight[kPixels];
    alignas(64) int32_t last[kPixels];         // for stopped pixels: the entry before the one that stopped them
};

constexpr int kConvexChunk = 32;  // this many fit into the L1 cache, and every block's walk reads them again

struct Chunk {
    alignas(64) Item items[kChunk];
    ConvexItem convexes[kConvexChunk];
    alignas(64) uint16_t masks[kChunk];
    uint64_t lists[16][kChunk / 64];  // for each block, a bit for each item that may touch it
    uint64_t seen[kChunk / 64];       // items that a block has walked past
    int n_convexes, points;
    float nearest;  // depth of the tile's first item; all depths are relative to it, so that a mean loses few digits to rounding
};

// Records the pixels that have just stopped because `falling` went below the threshold. This is rare and costs the walk one comparison.
__attribute__((noinline)) void stop_pixels(float* transmittance, int32_t* last, Float before, Float falling, int32_t index) {
    const Float line = set1(kMinTransmittance);
    const Mask fresh = (before >= line) & (falling < line);
    store(transmittance, select(fresh, before, load(transmittance)));
    store(last, select(fresh, set1(index), load(last)));
}

// Returns false once all of the block's pixels have stopped. first: index of the chunk's first item in the tile's list.
template <bool EXTRAS, bool CONVEXES>
inline bool forward_block(TilePixels& px, float* extra, int extras, int b, Chunk& chunk, int32_t first) {
    Float falling[kVectors], red[kVectors], green[kVectors], blue[kVectors], z[kVectors], weight[kVectors], X[kVectors], Y[kVectors];
    uint32_t open[kVectors], alive = 0;
    const Float line = set1(kMinTransmittance);
    for (int k = 0; k < kVectors; ++k) {
        const int at = 16 * b + k * kWidth;
        falling[k] = load(px.falling + at), weight[k] = load(px.weight + at);
        red[k] = load(px.red + at), green[k] = load(px.green + at), blue[k] = load(px.blue + at), z[k] = load(px.z + at);
        X[k] = load(kLaneX + k * kWidth) + set1(float(b % kSide * kBlock));
        Y[k] = load(kLaneY + k * kWidth) + set1(float(b / kSide * kBlock));
        open[k] = bits(falling[k] >= line);
    }
    for (int word = 0; word < kChunk / 64; ++word) {
        const uint64_t list = chunk.lists[b][word];
        uint64_t left = list;
        for (; left; left &= left - 1) {
            const int j = 64 * word + __builtin_ctzll(left);
            const Item& item = chunk.items[j];
            Float raws[kVectors];
            Mask counts[kVectors];
            if (!CONVEXES || item.convex < 0) {
                Float u, v;
                for (int k = 0; k < kVectors; ++k) raws[k] = gaussian_alpha(item, X[k], Y[k], u, v, counts[k]);
            } else {
                convex_alphas(chunk.convexes[item.convex], chunk.points, b, X, Y, raws, counts);
            }
            bool stops = false;
            Float before[kVectors];
            for (int k = 0; k < kVectors; ++k) {
                const Float alpha = keep(counts[k], min(raws[k], set1(kMaxAlpha)));
                before[k] = falling[k];
                falling[k] = fnma(before[k], alpha, before[k]);
                const Mask on = falling[k] >= line;
                const Float w = keep(on, before[k] * alpha);
                red[k] = fma(w, set1(item.color[0]), red[k]);
                green[k] = fma(w, set1(item.color[1]), green[k]);
                blue[k] = fma(w, set1(item.color[2]), blue[k]);
                z[k] = fma(w, set1(item.z), z[k]);
                weight[k] = weight[k] + w;  // depth is divided by this sum; 1 - transmittance would lose the digits of small weights
                if (EXTRAS && item.extras)
                    for (int e = 0; e < extras; ++e) {
                        float* p = extra + kPixels * e + 16 * b + k * kWidth;
                        store(p, fma(w, set1(item.extras[e]), load(p)));
                    }
                stops |= bits(on) != open[k];
            }
            if (__builtin_expect(stops, 0)) {
                alive = 0;
                for (int k = 0; k < kVectors; ++k) {
                    const int at = 16 * b + k * kWidth;
                    stop_pixels(px.transmittance + at, px.last + at, before[k], falling[k], first + j - 1);
                    open[k] = bits(falling[k] >= line);
                    alive |= open[k];
                }
                if (!alive) {
                    chunk.seen[word] |= list & (~uint64_t(0) >> (63 - j % 64));
                    goto done;
                }
            }
        }
        chunk.seen[word] |= list;
    }
    alive = 1;
done:
    for (int k = 0; k < kVectors; ++k) {
        const int at = 16 * b + k * kWidth;
        store(px.falling + at, falling[k]), store(px.weight + at, weight[k]);
        store(px.red + at, red[k]), store(px.green + at, green[k]), store(px.blue + at, blue[k]), store(px.z + at, z[k]);
    }
    return alive;
}

// Copies `count` <= 4 pixels of a plane in block order to a row of the image.
inline void copy_lanes(const float* from, float* to, int count) {
    if (count == 4) return void(__builtin_memcpy(to, from, 16));
    for (int i = 0; i < count; ++i) to[i] = from[i];
}

inline void write_pixels(const ForwardJob& job, TilePixels& px, const float* extra, int x0, int y0, int32_t entries, float nearest) {
    const int w = job.width - x0 < kTile ? job.width - x0 : kTile, h = job.height - y0 < kTile ? job.height - y0 : kTile;
    const Float line = set1(kMinTransmittance);
    for (int at = 0; at < kPixels; at += kWidth) {
        const Float falling = load(px.falling + at);
        const Mask open = falling >= line;
        const Float t = select(open, falling, load(px.transmittance + at));
        store(px.transmittance + at, t);
        store(px.last + at, select(open, set1(entries - 1), load(px.last + at)));
        store(px.red + at, fma(t, set1(job.background[0]), load(px.red + at)));
        store(px.green + at, fma(t, set1(job.background[1]), load(px.green + at)));
        store(px.blue + at, fma(t, set1(job.background[2]), load(px.blue + at)));
        const Float weight = load(px.weight + at), least = set1(1e-30f);  // depth is 0 where nothing was blended
        store(px.z + at, keep(weight >= least, fma(load(px.z + at), reciprocal(max(weight, least)), set1(nearest))));
    }
    for (int y = 0; y < h; ++y)
        for (int x = 0; x < w; x += 4) {
            const int at = 16 * (y / 4 * kSide + x / 4) + y % 4 * 4, count = w - x < 4 ? w - x : 4;
            const int64_t to = int64_t(y0 + y) * job.width + x0 + x;
            float* color = job.color + 3 * to;
            for (int i = 0; i < count; ++i) {
                color[3 * i] = px.red[at + i], color[3 * i + 1] = px.green[at + i], color[3 * i + 2] = px.blue[at + i];
                for (int e = 0; e < job.extras; ++e) job.extra[(to + i) * job.extras + e] = extra[kPixels * e + at + i];
            }
            copy_lanes(px.weight + at, job.alpha + to, count);
            copy_lanes(px.z + at, job.depth + to, count);
            if (!job.transmittance) continue;
            copy_lanes(px.transmittance + at, job.transmittance + to, count);
            for (int i = 0; i < count; ++i) job.last[to + i] = px.last[at + i];
        }
}

// Gathers items starting at entry `at`, with the blocks that each may touch. Returns their number.
inline int gather_chunk(const ForwardJob& job, uint64_t at, uint64_t end, int x0, int y0, uint32_t alive, Chunk& chunk) {
    const int most = end - at < kChunk ? int(end - at) : kChunk;
    chunk.n_convexes = 0, chunk.points = job.points;
    int n = 0;
    for (; n < most && chunk.n_convexes < kConvexChunk; ++n) {
        const int j = n;
        if (at + j + 8 < end) prefetch(job, job.entries[at + j + 8].primitive);
        const uint32_t id = job.entries[at + j].primitive;
        Item& item = chunk.items[j];
        gather(job, id, x0 + 0.5, y0 + 0.5, item, chunk.convexes, chunk.n_convexes);
        item.z -= chunk.nearest;
        const uint32_t mask = id < job.n_gaussians ? gaussian_blocks(item, job.gaussians[id].radius) : convex_blocks(chunk.convexes[item.convex], job.points, alive);
        chunk.masks[j] = uint16_t(mask);
    }
    __builtin_memcpy(job.masks + at, chunk.masks, sizeof(uint16_t) * size_t(n));
    for (int j = n; j < kChunk; ++j) chunk.masks[j] = 0;
    lists_of_bits(chunk.masks, chunk.lists);
    for (uint64_t& word : chunk.seen) word = 0;
    return n;
}

template <bool EXTRAS>
void forward_tile_impl(const ForwardJob& job, int tile, float* extra) {
    const int x0 = tile % job.tiles_x * kTile, y0 = tile / job.tiles_x * kTile;
    TilePixels px;
    uint32_t alive = 0;
    const bool whole = x0 + kTile <= job.width && y0 + kTile <= job.height;
    for (int at = 0; at < kPixels; at += kWidth) {
        store(px.falling + at, set1(1.0f)), store(px.transmittance + at, set1(1.0f));
        store(px.red + at, zero()), store(px.green + at, zero()), store(px.blue + at, zero()), store(px.z + at, zero());
        store(px.weight + at, zero()), store(px.last + at, set1(-1));
    }
    for (int i = 0; !whole && i < kPixels; ++i) {
        const int b = i / 16, x = x0 + b % kSide * 4 + i % 4, y = y0 + b / kSide * 4 + i % 16 / 4;
        const bool inside = x < job.width && y < job.height;
        if (!inside) px.falling[i] = 0.0f;
        alive |= uint32_t(inside) << b;
    }
    if (whole) alive = kAllBlocks;
    if (EXTRAS) __builtin_memset(extra, 0, sizeof(float) * kPixels * size_t(job.extras));

    Chunk chunk;
    const uint64_t begin = job.tile_begin[tile], end = job.tile_begin[tile + 1];
    chunk.nearest = begin < end ? depth_of(job, job.entries[begin].primitive) : 0.0f;
    for (uint64_t at = begin, n; at < end && alive; at += n) {
        n = uint64_t(gather_chunk(job, at, end, x0, y0, alive, chunk));
        for (uint32_t m = alive; m; m &= m - 1) {
            const int b = __builtin_ctz(m);
            const int32_t first = int32_t(at - begin);
            const bool open = chunk.n_convexes ? forward_block<EXTRAS, true>(px, extra, job.extras, b, chunk, first)
                                               : forward_block<EXTRAS, false>(px, extra, job.extras, b, chunk, first);
            if (!open) alive &= ~(1u << b);
        }
        for (int word = 0; word < kChunk / 64; ++word)
            for (uint64_t m = chunk.seen[word]; m; m &= m - 1) {
                const uint32_t id = job.entries[at + 64 * word + __builtin_ctzll(m)].primitive;
                // Atomic, because several tiles may write the same 1.
                uint8_t* flag = id < job.n_gaussians ? job.visible_gaussians + id : job.visible_convexes + (id - job.n_gaussians);
                __atomic_store_n(flag, uint8_t(1), __ATOMIC_RELAXED);
            }
    }
    write_pixels(job, px, extra, x0, y0, int32_t(end - begin), chunk.nearest);
}

void forward_tile(const ForwardJob& job, int tile, float* scratch) {
    job.extras ? forward_tile_impl<true>(job, tile, scratch) : forward_tile_impl<false>(job, tile, scratch);
}
