// A block blends one tile, each of its four warps a region of 8 x 8 pixels, and each lane two pixels. The tile's primitives are loaded into
// shared memory in batches. A warp walks only those that may touch its region. Features: POINTS, EXTRAS.
#include "alpha.cuh"

namespace e4dgs {

constexpr int kBatch = kBlendThreads;

struct Pixel {
    float transmittance, red, green, blue, z, weight;
    float extra[EXTRAS ? EXTRAS : 1];
    int last;   // for a stopped pixel: the entry before the one that stopped it
    bool open;

    __device__ __forceinline__ bool stops(float alpha) const { return open && transmittance - transmittance * alpha < kMinTransmittance; }

    __device__ __forceinline__ void blend(float alpha, float item_z, const float4& color, const float* extras) {
        const float w = transmittance * alpha;
        transmittance = transmittance - transmittance * alpha;
        red = fmaf(w, color.x, red), green = fmaf(w, color.y, green), blue = fmaf(w, color.z, blue);
        z = fmaf(w, item_z, z);
        weight += w;  // depth is divided by this sum; 1 - transmittance would lose the digits of small weights
#pragma unroll
        for (int e = 0; e < EXTRAS; ++e) extra[e] = fmaf(w, extras[e], extra[e]);
    }
};

}  // namespace e4dgs

using namespace e4dgs;

// begins [tiles + 1], entries [begins[tiles]]: the lists of the tiles, as slots. touched [entries] gets a bit for each region that blends the
// entry, and visible [primitives], of which the convexes begin at first_convex, gets a 1. touched, transmittance and last may be null if no backward pass follows; color, alpha and depth may
// be null if another launch wrote them. channels: number of all extras; this launch blends EXTRAS of them, starting at first_channel.
extern "C" __global__ void __launch_bounds__(kBlendThreads, kResident)
    blend_forward(const GaussianRecord* gaussians, const ConvexRecord* convexes, const int* ids, const float* gaussian_extras, const float* convex_extras,
                  const int64* counts, int channels, int first_channel, const int* begins, const int* entries, int width, int height, const float* background, float* color,
                  float* alpha, float* depth, float* extra, float* transmittance, int* last, uint8* touched, int first_convex, uint8* visible) {
    __shared__ float4 items[kBatch][kItemWords];
    __shared__ float extras[kBatch][EXTRAS ? EXTRAS : 1];
    __shared__ uint8 marks[kBatch], seen[kRegions][kBatch];

    const Primitives all = {gaussians, convexes, ids, gaussian_extras, convex_extras, int(counts[kKeptGaussians]), channels, first_channel};
    const int tile = int(blockIdx.x), tiles_x = (width + kTile - 1) / kTile, x0 = tile % tiles_x * kTile, y0 = tile / tiles_x * kTile;
    const int thread = int(threadIdx.x), lane = thread % 32, region = thread / 32;
    const int lane_x = region % 2 * kRegion + lane % kRegion, lane_y = region / 2 * kRegion + lane / kRegion;
    const float X = float(lane_x), Y = float(lane_y);
    const int begin = begins[tile], end = begins[tile + 1];
    const float nearest = begin < end ? depth_of(all, entries[begin]) : 0.0f;  // origin of depths, so that means lose few digits

    Pixel px[kLanePixels];
#pragma unroll
    for (int p = 0; p < kLanePixels; ++p) {
        px[p] = Pixel{1.0f, 0.0f, 0.0f, 0.0f, 0.0f, 0.0f, {}, end - begin - 1, x0 + lane_x < width && y0 + lane_y + 4 * p < height};
    }
    bool alive = __any_sync(kAllLanes, px[0].open || px[1].open);  // whether the warp has open pixels

    for (int at = begin; at < end; at += kBatch) {
        if (!__syncthreads_or(alive)) break;
        const int n = end - at < kBatch ? end - at : kBatch;
        int id = 0;
        if (thread < n) {
            id = entries[at + thread];
            marks[thread] = uint8(gather(all, id, x0 + 0.5, y0 + 0.5, nearest, items[thread], extras[thread]));
        }
        for (int r = 0; r < kRegions; ++r) seen[r][thread] = 0;
        __syncthreads();
        for (int base = 0; base < n && alive; base += 32) {
            const uint32 mark = base + lane < n ? marks[base + lane] : 0;
            uint32 list = __ballot_sync(kAllLanes, mark >> region & 1);
#if POINTS
            const uint32 convex = __ballot_sync(kAllLanes, (mark & kConvexMark) != 0);
#endif
            for (; list && alive; list &= list - 1) {
                const int bit = __ffs(int(list)) - 1, j = base + bit;
                const float4* item = items[j];
                float raw[kLanePixels], z;
                bool counted[kLanePixels];
#if POINTS
                if (convex >> bit & 1) {
                    const float4 head = item[0];
                    ConvexAlpha value;
#pragma unroll
                    for (int p = 0; p < kLanePixels; ++p) {
                        value.at(item + 3, head.x, head.y, X, Y + kLaneStep * p);
                        raw[p] = value.alpha, counted[p] = value.counted;
                    }
                    z = head.z;
                } else
#endif
                {
                    const float4 a = item[0], b = item[1];
                    GaussianAlpha value;
#pragma unroll
                    for (int p = 0; p < kLanePixels; ++p) {
                        value.at(a, b, X, Y + kLaneStep * p);
                        raw[p] = value.alpha, counted[p] = value.counted;
                    }
                    z = b.z;
                }
                bool stopped = false, blends = false;
                float layer[kLanePixels];
#pragma unroll
                for (int p = 0; p < kLanePixels; ++p) {
                    layer[p] = counted[p] && px[p].open ? fminf(raw[p], kMaxAlpha) : 0.0f;
                    if (px[p].stops(layer[p])) {
                        px[p].open = false, px[p].last = at - begin + j - 1;
                        layer[p] = 0.0f;
                        stopped = true;
                    }
                    blends = blends || layer[p] > 0.0f;
                }
                if (__any_sync(kAllLanes, blends)) {
                    const float4 tint = item[2];
#pragma unroll
                    for (int p = 0; p < kLanePixels; ++p) px[p].blend(layer[p], z, tint, extras[j]);
                    if (lane == 0) seen[region][j] = 1;
                }
                if (__any_sync(kAllLanes, stopped)) alive = __any_sync(kAllLanes, px[0].open || px[1].open);
            }
        }
        __syncthreads();
        if (thread < n) {
            uint32 mask = 0;
            for (int r = 0; r < kRegions; ++r) mask |= uint32(seen[r][thread]) << r;
            if (mask && touched) touched[at + thread] = uint8(mask);
            if (mask) visible[ids[id] + (id < all.n_gaussians ? 0 : first_convex)] = 1;  // several tiles may write the same 1
        }
    }

#pragma unroll
    for (int p = 0; p < kLanePixels; ++p) {
        const int x = x0 + lane_x, y = y0 + lane_y + 4 * p;
        if (x >= width || y >= height) continue;
        const int64 to = int64(y) * width + x;
        const Pixel& q = px[p];
        const float t = q.transmittance;
        if (color) {
            color[3 * to] = fmaf(t, background[0], q.red);
            color[3 * to + 1] = fmaf(t, background[1], q.green);
            color[3 * to + 2] = fmaf(t, background[2], q.blue);
        }
        if (alpha) alpha[to] = q.weight;
        if (depth) depth[to] = q.weight >= 1e-30f ? fmaf(q.z, 1.0f / q.weight, nearest) : 0.0f;  // 0 where nothing was blended
        for (int e = 0; e < EXTRAS; ++e) extra[to * channels + first_channel + e] = q.extra[e];
        if (transmittance) transmittance[to] = t, last[to] = q.last;
    }
}
