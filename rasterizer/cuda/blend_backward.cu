// The backward pass of a tile, from the last blended primitive to the first. Each pixel keeps its transmittance T, which is restored by
// dividing by (1 - alpha), and `behind`, the contribution of everything behind to the gradient. With f = dL/dw of a layer,
// dL/dalpha = T f - behind / (1 - alpha). A warp sums over its 64 pixels before anything leaves the registers, and the four warps of a tile
// combine their sums in shared memory. So there is one addition to global memory per value, primitive and tile. Features: POINTS, EXTRAS,
// DEPTH (1: the depth image has a gradient).
#include "alpha.cuh"
#include "warp_sum.cuh"

#if !defined(DEPTH)
#define DEPTH 0
#endif

namespace e4dgs {

constexpr int kBatch = POINTS ? 32 : 64;
constexpr int kShapeSums = kConvexSums > kGaussianSums ? kConvexSums : kGaussianSums;
constexpr int kSums = kShapeSums + EXTRAS;  // number of sums in a slot

struct Pixel {
    float transmittance, behind, red, green, blue;
    float z, depth;  // z: gradient of sum w z, which is depth's gradient / alpha; depth: the weighted mean itself
    float extra[EXTRAS ? EXTRAS : 1];
    int last;
};

struct Layer {  // the values that both kinds have
    float z;
    float4 tint;
    const float* extras;
    int index;  // position in the tile's list
};

// Adds color 3 and z to sums, and adds to extras. Returns dL/dalpha alpha, or 0 if alpha is capped.
__device__ __forceinline__ float layer_backward(Pixel& px, const Layer& layer, float raw, bool counted, float* sums, float* extras) {
    const float alpha = counted && px.last >= layer.index ? fminf(raw, kMaxAlpha) : 0.0f;
    // The reciprocal is refined once. Otherwise, over thousands of layers with the same alpha, its error would add up in the transmittance.
    const float through = 1.0f - alpha, rough = reciprocal(through), inverse = fmaf(rough, fmaf(-through, rough, 1.0f), rough);
    const float before = px.transmittance * inverse, behind = px.behind, w = before * alpha;
    float f = fmaf(px.red, layer.tint.x, fmaf(px.green, layer.tint.y, px.blue * layer.tint.z));
    sums[0] = fmaf(w, px.red, sums[0]), sums[1] = fmaf(w, px.green, sums[1]), sums[2] = fmaf(w, px.blue, sums[2]);
#if DEPTH
    // Depth is a weighted mean, so a layer changes it by its own distance from the mean, while everything behind, taken together, does not.
    f = fmaf(px.z, layer.z - px.depth, f);
    sums[3] = fmaf(w, px.z, sums[3]);
#endif
#pragma unroll
    for (int e = 0; e < EXTRAS; ++e) {
        f = fmaf(px.extra[e], layer.extras[e], f);
        extras[e] = fmaf(w, px.extra[e], extras[e]);
    }
    px.transmittance = before;
    px.behind = fmaf(w, f, behind);
    return raw < kMaxAlpha ? alpha * fmaf(-behind, inverse, before * f) : 0.0f;
}

// Sums v [V] over the warp. The totals go to `shape`, except for the last EXTRAS, which go to `extras`.
template <int V>
__device__ __forceinline__ void add_up(float* v, int lane, float* shape, float* extras) {
    const int mine = warp_total_of<V>(lane);
    const float total = warp_totals<V>(v, lane);
    if (mine < 0) return;
    (mine < V - EXTRAS ? shape[mine] : extras[mine - (V - EXTRAS)]) = total;
}

// Sums v [SHAPE + EXTRAS], all sums of a layer, over the warp and writes the totals to `row`.
template <int SHAPE>
__device__ __forceinline__ void add_layer(float* v, int lane, float* row) {
    if constexpr (next_power(SHAPE + EXTRAS) == next_power(SHAPE) && SHAPE + EXTRAS <= 32) {
        add_up<SHAPE + EXTRAS>(v, lane, row, row + kShapeSums);
    } else {
        const int mine = warp_total_of<SHAPE>(lane), other = warp_total_of<EXTRAS>(lane);
        const float total = warp_totals<SHAPE>(v, lane), more = warp_totals<EXTRAS>(v + SHAPE, lane);
        if (mine >= 0) row[mine] = total;
        if (other >= 0) row[kShapeSums + other] = more;
    }
}

}  // namespace e4dgs

using namespace e4dgs;

// Gradients of images may be null, which counts as zero. alpha and depth: images of the frame, read if DEPTH is 1. touched: see
// blend_forward. Without slots, the sums are added to gaussian_sums [kept, kGaussianSums], convex_sums [kept, kConvexSums] and dextras
// [*, channels] atomically, in no fixed order. With slots [pairs, kSums], the sums of each (tile, primitive) pair are written to the row given
// by `pair` [entries].
extern "C" __global__ void __launch_bounds__(kBlendThreads, kResident)
    blend_backward(const GaussianRecord* gaussians, const ConvexRecord* convexes, const int* ids, const float* gaussian_extras, const float* convex_extras,
                   const int64* counts, int channels, int first_channel, const int* begins, const int* entries, const uint8* touched, int width, int height, const float* background,
                   const float* transmittance, const int* last, const float* grad_color, const float* grad_alpha, const float* grad_depth,
                   const float* grad_extra, const float* alpha, const float* depth, float* gaussian_sums, float* convex_sums, float* gaussian_dextras,
                   float* convex_dextras, const int* pair, float* slots) {
    __shared__ float4 items[kBatch][kItemWords];
    __shared__ float extras[kBatch][EXTRAS ? EXTRAS : 1];
    __shared__ float rows[kRegions][kBatch][kSums];
    __shared__ uint8 marks[kBatch];
    __shared__ int listed[kBatch], lasts[kRegions];

    const int n_gaussians = int(counts[kKeptGaussians]);
    const Primitives all = {gaussians, convexes, ids, gaussian_extras, convex_extras, n_gaussians, channels, first_channel};
    const int tile = int(blockIdx.x), tiles_x = (width + kTile - 1) / kTile, x0 = tile % tiles_x * kTile, y0 = tile / tiles_x * kTile;
    const int thread = int(threadIdx.x), lane = thread % 32, region = thread / 32;
    const int lane_x = region % 2 * kRegion + lane % kRegion, lane_y = region / 2 * kRegion + lane / kRegion;
    const float X = float(lane_x), Y = float(lane_y);
    const int begin = begins[tile], end = begins[tile + 1];
    if (begin == end) return;
    const float nearest = depth_of(all, entries[begin]);

    Pixel px[kLanePixels];
    int furthest = -1;
#pragma unroll
    for (int p = 0; p < kLanePixels; ++p) {
        Pixel& q = px[p];
        q = Pixel{0.0f, 0.0f, 0.0f, 0.0f, 0.0f, 0.0f, 0.0f, {}, -1};
        const int x = x0 + lane_x, y = y0 + lane_y + 4 * p;
        if (x >= width || y >= height) continue;
        const int64 at = int64(y) * width + x;
        float through = 0.0f;  // dL/dT of the light that passes all layers
        if (grad_color) {
            q.red = grad_color[3 * at], q.green = grad_color[3 * at + 1], q.blue = grad_color[3 * at + 2];
            through = fmaf(q.red, background[0], fmaf(q.green, background[1], q.blue * background[2]));
        }
        if (grad_alpha) through -= grad_alpha[at];
#if DEPTH
        if (alpha[at] > 0.0f) q.z = grad_depth[at] / alpha[at], q.depth = depth[at] - nearest;
#endif
        for (int e = 0; e < EXTRAS; ++e) q.extra[e] = grad_extra ? grad_extra[at * channels + first_channel + e] : 0.0f;
        q.transmittance = transmittance[at];
        q.behind = q.transmittance * through;
        q.last = last[at];
        furthest = furthest > q.last ? furthest : q.last;
    }
    for (int offset = 16; offset; offset /= 2) {
        const int other = __shfl_xor_sync(kAllLanes, furthest, offset);
        furthest = furthest > other ? furthest : other;
    }
    if (lane == 0) lasts[region] = furthest;
    __syncthreads();
    for (int r = 0; r < kRegions; ++r) furthest = furthest > lasts[r] ? furthest : lasts[r];

    for (int top = furthest + 1; top > 0; top -= kBatch) {
        const int first = top > kBatch ? top - kBatch : 0, n = top - first;
        __syncthreads();  // nobody uses the previous batch in shared memory any more
        if (thread < n) {
            const int at = begin + first + thread, id = entries[at];
            uint32 mark = touched[at];
            listed[thread] = id;
            if (mark) {
                mark |= gather(all, id, x0 + 0.5, y0 + 0.5, nearest, items[thread], extras[thread]) & kConvexMark;
#if POINTS
                if (mark & kConvexMark) {
                    const ConvexRecord& r = convexes[id - n_gaussians];
                    items[thread][1] = make_float4(float(x0 + 0.5 - r.x0), float(y0 + 0.5 - r.y0), 0.0f, 0.0f);  // convex's centre to tile's origin
                }
#endif
            }
            marks[thread] = uint8(mark);
        }
        __syncthreads();

        for (int base = (n - 1) / 32 * 32; base >= 0; base -= 32) {
            const uint32 mark = base + lane < n ? marks[base + lane] : 0;
            uint32 list = __ballot_sync(kAllLanes, mark >> region & 1);
#if POINTS
            const uint32 convex = __ballot_sync(kAllLanes, (mark & kConvexMark) != 0);
#endif
            while (list) {
                const int bit = 31 - __clz(int(list)), j = base + bit;
                list ^= 1u << bit;
                const float4* item = items[j];
                Layer layer;
                layer.tint = item[2], layer.extras = extras[j], layer.index = first + j;
#if POINTS
                if (convex >> bit & 1) {
                    const float4 head = item[0];
                    float v[kConvexSums + EXTRAS];
#pragma unroll
                    for (int i = 0; i < kConvexSums + EXTRAS; ++i) v[i] = 0.0f;
                    layer.z = head.z;
#pragma unroll
                    for (int p = 0; p < kLanePixels; ++p) {
                        const float y = Y + kLaneStep * p;
                        ConvexAlpha value;
                        value.at(item + 3, head.x, head.y, X, y);
                        const float g = layer_backward(px[p], layer, value.alpha, value.counted, v, v + kConvexSums);
                        const float h = g * value.outside, share = h * reciprocal(value.sum);
                        v[4] += g;
                        v[5] = fmaf(h, value.lse, v[5]);
                        float spread = fmaf(h, value.spread, v[6]);
#pragma unroll
                        for (int i = 0; i < POINTS; ++i) {
                            const float q = share * value.edge[i];
                            spread = fmaf(-q, value.over[i], spread);
                            float* edge = v + kConvexEdges + 3 * i;
                            edge[0] = fmaf(q, X, edge[0]), edge[1] = fmaf(q, y, edge[1]), edge[2] += q;
                        }
                        v[6] = spread;
                    }
                    add_layer<kConvexSums>(v, lane, rows[region][j]);
                    continue;
                }
#endif
                const float4 a = item[0], b = item[1];
                float v[kGaussianSums + EXTRAS];
#pragma unroll
                for (int i = 0; i < kGaussianSums + EXTRAS; ++i) v[i] = 0.0f;
                layer.z = b.z;
#pragma unroll
                for (int p = 0; p < kLanePixels; ++p) {
                    GaussianAlpha value;
                    value.at(a, b, X, Y + kLaneStep * p);
                    const float g = layer_backward(px[p], layer, value.alpha, value.counted, v, v + kGaussianSums);
                    const float gu = g * value.u, gv = g * value.v;
                    v[4] += g, v[5] += gu, v[6] += gv;
                    v[7] = fmaf(gu, value.u, v[7]), v[8] = fmaf(gu, value.v, v[8]), v[9] = fmaf(gv, value.v, v[9]);
                }
                add_layer<kGaussianSums>(v, lane, rows[region][j]);
            }
        }
        __syncthreads();

        for (int k = thread; k < n * kSums; k += kBlendThreads) {
            const int j = k / kSums, c = k % kSums;
            const uint32 mark = marks[j];
            const bool convex = mark & kConvexMark;
            if (!(mark & 15) || (c < kShapeSums && c >= (convex ? kConvexSums : kGaussianSums))) continue;
            const auto sum_of = [&](int column) {
                float sum = 0.0f;
                for (int r = 0; r < kRegions; ++r) sum += mark >> r & 1 ? rows[r][j][column] : 0.0f;
                return sum;
            };
            float sum = sum_of(c);
#if POINTS
            if (convex && c >= kConvexEdges && c < kConvexSums) {  // (X, Y) become relative to the convex's centre
                const int part = (c - kConvexEdges) % 3;
                if (part < 2) sum += (part ? items[j][1].y : items[j][1].x) * sum_of(c - part + 2);
            }
#endif
            const int id = listed[j], index = convex ? id - n_gaussians : id;
            if (slots)
                slots[int64(pair[begin + first + j]) * kSums + c] = sum;
            else if (c >= kShapeSums)
                atomicAdd((convex ? convex_dextras : gaussian_dextras) + int64(all.ids[id]) * channels + first_channel + (c - kShapeSums), sum);
            else
                atomicAdd(convex ? convex_sums + int64(index) * kConvexSums + c : gaussian_sums + int64(index) * kGaussianSums + c, sum);
        }
    }
}

// For deterministic sums: adds the slots of each primitive in the order of its pairs, in double. One thread per primitive and column;
// order and ends as in write_pairs. Adds to the existing values, so that launches for more extras add to the same sums.
extern "C" __global__ void __launch_bounds__(256)
    sum_slots(const int64* counts, const int* ids, const int* order, const int64* ends, int64 room, const float* slots, int channels, int first_channel, float* gaussian_sums,
              float* convex_sums, float* gaussian_dextras, float* convex_dextras) {
    const int64 k = int64(blockIdx.x) * blockDim.x + threadIdx.x;
    const int64 rank = k / kSums;
    const int c = int(k % kSums);
    if (rank >= counts[kKept]) return;
    const int n_gaussians = int(counts[kKeptGaussians]);
    const int64 begin = rank ? ends[rank - 1] : 0, end = ends[rank] < room ? ends[rank] : room;
    const int id = order[rank];
    const bool convex = id >= n_gaussians;
    if (begin >= end || (c < kShapeSums && c >= (convex ? kConvexSums : kGaussianSums))) return;
    double sum = 0.0;
    for (int64 at = begin; at < end; ++at) sum += double(slots[at * kSums + c]);
    const int index = convex ? id - n_gaussians : id;
    float* to = convex ? convex_sums + int64(index) * kConvexSums + c : gaussian_sums + int64(index) * kGaussianSums + c;
    if (c >= kShapeSums) to = (convex ? convex_dextras : gaussian_dextras) + int64(ids[id]) * channels + first_channel + (c - kShapeSums);
    *to = float(double(*to) + sum);
}
