// From what is learned of primitives to what is rendered, forward and backward: see `PrimitiveSet.activated`. A block does kPrimitives rows of
// all tensors, which are contiguous: wide rows number by number, so that neighbouring threads touch neighbouring numbers, the rest by rows.
#include "block_sums.cuh"
#include "rotation.cuh"

namespace e4dgs {

constexpr int kPrimitives = 128;                      // of a block, which has as many threads
constexpr float kGrey = 0.5f / 0.28209479177387814f;  // a colour is 0.5 + 0.282... dc

// f(thread), f(thread + kPrimitives), ... below count.
template <class F>
__device__ __forceinline__ void each_number(int count, F&& f) {
    for (int k = int(threadIdx.x); k < count; k += kPrimitives) f(k);
}

struct Rows {
    int64 first;  // of the block
    int count;

    __device__ __forceinline__ explicit Rows(int n) {
        first = int64(blockIdx.x) * kPrimitives;
        count = n - first < kPrimitives ? int(n - first) : kPrimitives;
    }
};

__device__ __forceinline__ Vec lit(Vec dc) { return {dc.x + kGrey, dc.y + kGrey, dc.z + kGrey}; }

}  // namespace e4dgs

using namespace e4dgs;

// logs and sizes [n, width], others and other_sizes [n] or null; logits and opacities [n]; dc [n, 3]; rest [n, stored, 3], of which sh
// [n, 1 + shown, 3] gets the first ones; shades [n, 3] and light [3], or null.
extern "C" __global__ void __launch_bounds__(kPrimitives)
    look(int n, int width, int stored, int shown, const float* logs, const float* others, const float* logits, const float* dc,
         const float* rest, const float* shades, const float* light, float* sizes, float* other_sizes, float* opacities, float* sh) {
    const Rows rows(n);
    each_number(rows.count * width, [&](int k) { sizes[rows.first * width + k] = expf(logs[rows.first * width + k]); });
    each_number(rows.count * 3 * shown, [&](int k) {
        const int row = k / (3 * shown), at = k % (3 * shown);
        sh[(rows.first + row) * 3 * (1 + shown) + 3 + at] = rest[(rows.first + row) * 3 * stored + at];
    });
    if (int(threadIdx.x) >= rows.count) return;
    const int64 i = rows.first + threadIdx.x;
    opacities[i] = 1.0f / (1.0f + expf(-logits[i]));
    if (others) other_sizes[i] = expf(others[i]);
    const Vec own = load_vec(dc + 3 * i);
    store_vec(sh + 3 * (1 + shown) * i, light ? own + dot(load_vec(shades + 3 * i), load_vec(light)) * lit(own) : own);
}

// g_*: incoming gradients, each null if there is none. d_*: those of the inputs, written in full, or null if there is none; d_light
// [blocks, 3] are the parts of the blocks.
extern "C" __global__ void __launch_bounds__(kPrimitives)
    look_backward(int n, int width, int stored, int shown, const float* logs, const float* others, const float* logits, const float* dc,
                  const float* shades, const float* light, const float* g_sizes, const float* g_others, const float* g_opacities,
                  const float* g_sh, float* d_logs, float* d_others, float* d_logits, float* d_dc, float* d_rest, float* d_shades,
                  float* d_light) {
    const Rows rows(n);
    each_number(d_logs ? rows.count * width : 0, [&](int k) {
        const int64 at = rows.first * width + k;
        d_logs[at] = g_sizes[at] * expf(logs[at]);
    });
    each_number(d_rest ? rows.count * 3 * stored : 0, [&](int k) {
        const int row = k / (3 * stored), at = k % (3 * stored);
        d_rest[rows.first * 3 * stored + k] = at < 3 * shown ? g_sh[(rows.first + row) * 3 * (1 + shown) + 3 + at] : 0.0f;
    });
    const bool mine = int(threadIdx.x) < rows.count;
    const int64 i = rows.first + threadIdx.x;
    if (mine && d_others) d_others[i] = g_others[i] * expf(others[i]);
    if (mine && d_logits) {
        const float e = expf(-fabsf(logits[i]));  // so that opacities near one keep the digits of their slope
        d_logits[i] = g_opacities[i] * e / ((1.0f + e) * (1.0f + e));
    }
    if (!d_dc) return;
    const Vec g = mine ? load_vec(g_sh + 3 * (1 + shown) * i) : Vec{0.0f, 0.0f, 0.0f};
    if (!light) {
        if (mine) store_vec(d_dc + 3 * i, g);
        return;
    }
    float by_light[3] = {0.0f, 0.0f, 0.0f};
    if (mine) {
        const Vec shade = load_vec(shades + 3 * i), courses = load_vec(light);
        const float by_gain = dot(g, lit(load_vec(dc + 3 * i)));
        store_vec(d_dc + 3 * i, (1.0f + dot(shade, courses)) * g);
        store_vec(d_shades + 3 * i, by_gain * courses);
        store_vec(by_light, by_gain * shade);
    }
    block_sums<kPrimitives, 3>(by_light, d_light + 3 * int64(blockIdx.x));
}
