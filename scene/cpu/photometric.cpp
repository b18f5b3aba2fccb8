#include "photometric.h"

#include <algorithm>
#include <cstdint>
#include <vector>

#include "kept_buffer.h"
#include "photometric_rows.h"

namespace e4dgs {
namespace {

// The image goes through in strips of rows. Within a strip, three passes follow each other, kTogether rows at a time: moments, SSIM and its
// derivatives, gradient. Each pass keeps only the rows that the next one still needs, in a ring that stays in the cache.
constexpr int kRing = 16;        // rows kept
constexpr int kBehind = 3;       // groups of kTogether rows between a pass and the next
constexpr int kLeastStrip = 32;  // rows; the passes before the last also do the rows above and below a strip
static_assert(kRing % kTogether == 0 && kBehind * kTogether >= 2 * kRadius && kRing >= (kBehind + 1) * kTogether);

struct Images {
    const float *x, *y, *weight;  // x: as recorded
    const float* raw;             // null if nothing weighs or changes the gradient
    const Recording recording;
    float* grad;
    int height, n;
    float scale_l1, scale_ssim;
    double *ssim, *l1;           // sums of each row
    double *d_gain, *d_offset;   // [H,3], of each row
};

// Rows of a strip's memory, each `stride` floats apart: an odd number of cache lines, so that the rows of a ring do not compete for one place.
struct Strip {
    static constexpr int kRows = kRing * (kMoments + kDerivatives) + kTogether * (1 + kDerivatives) + 2;
    static size_t stride(int n) { return size_t(((n + 2 * kPad + kSpare) / 16 + 1) | 1) * 16; }

    Strip(const Images& images, float* memory) : in(images), memory_(memory), stride_(stride(images.n)) {
        for (int k = 0; k < kTogether * kDerivatives + 2; ++k) std::fill(memory_ + k * stride_, memory_ + (k + 1) * stride_, 0.0f);
    }

    // Rows first .. last of the gradient.
    void run(int first, int last) {
        for (int group = 0; group < kBehind; ++group) moments(first - 2 * kRadius + kTogether * group);
        const int groups = (last - first + kTogether - 1) / kTogether;
        for (int group = 0; group < groups + kBehind; ++group) {
            moments(first - 2 * kRadius + kTogether * (group + kBehind));
            ssim(first - kRadius + kTogether * group, first, last);
            if (group >= kBehind) gradient(first + kTogether * (group - kBehind), last);
        }
    }

private:
    const Images& in;
    float* memory_;
    size_t stride_;

    bool inside(int row) const { return row >= 0 && row < in.height; }
    float* row(int k) const { return memory_ + k * stride_; }
    const float* zeros() const { return row(0); }
    float* padded(int o, int k) const { return row(2 + kDerivatives * o + k); }
    float* ssim_of(int o) const { return row(2 + kTogether * kDerivatives + o); }
    float* ring(int k, int at) const { return row(2 + kTogether * (1 + kDerivatives) + k * kRing + (at & (kRing - 1))); }
    const float* image(const float* from, int at) const { return inside(at) ? from + int64_t(at) * in.n : zeros(); }

    void moments(int begin) {
        for (int at = std::max(begin, 0); at < std::min(begin + kTogether, in.height); ++at) {
            float* const out[kMoments] = {ring(0, at), ring(1, at), ring(2, at), ring(3, at)};
            moments_row(image(in.x, at), image(in.y, at), in.n, out, row(1));
        }
    }

    void ssim(int begin, int first, int last) {
        const float* maps[kMoments][kSpan];
        for (int k = 0; k < kMoments; ++k)
            for (int j = 0; j < kSpan; ++j) maps[k][j] = inside(begin + j - kRadius) ? ring(k, begin + j - kRadius) : zeros();
        SsimRow out[kTogether];
        for (int o = 0; o < kTogether; ++o) out[o] = {ssim_of(o), {padded(o, 0) + kPad, padded(o, 1) + kPad, padded(o, 2) + kPad}};
        ssim_rows(maps, in.n, out);
        const float *x[kTogether], *y[kTogether];
        double sums[kTogether], differences[kTogether];
        for (int o = 0; o < kTogether; ++o) x[o] = image(in.x, begin + o), y[o] = image(in.y, begin + o);
        sum_rows(out, x, y, in.n, sums, differences);
        for (int o = 0; o < kTogether; ++o) {
            const int at = begin + o;
            if (at >= first && at < last) in.ssim[at] = sums[o], in.l1[at] = differences[o];
            if (!inside(at)) continue;
            const float* const from[kDerivatives] = {padded(o, 0), padded(o, 1), padded(o, 2)};
            float* const to[kDerivatives] = {ring(kMoments, at), ring(kMoments + 1, at), ring(kMoments + 2, at)};
            derivative_row(from, in.n, to);
        }
    }

    void gradient(int begin, int last) {
        const float *maps[kDerivatives][kSpan], *x[kTogether], *y[kTogether];
        float* grad[kTogether];
        for (int k = 0; k < kDerivatives; ++k)
            for (int j = 0; j < kSpan; ++j) maps[k][j] = inside(begin + j - kRadius) ? ring(kMoments + k, begin + j - kRadius) : zeros();
        for (int o = 0; o < kTogether; ++o) {
            x[o] = image(in.x, begin + o), y[o] = image(in.y, begin + o);
            grad[o] = begin + o < last ? in.grad + int64_t(begin + o) * in.n : nullptr;
        }
        gradient_rows(x, y, maps, in.n, in.scale_l1, in.scale_ssim, grad);
        const int pixels = in.n / kChannels;
        for (int o = 0; o < kTogether && grad[o] && in.raw; ++o) {
            const int64_t at = begin + o;
            const float* const weight = in.weight ? in.weight + at * pixels : nullptr;
            weigh_row(in.raw + at * in.n, weight, in.recording.gain, pixels, grad[o], in.d_gain + kChannels * at, in.d_offset + kChannels * at);
        }
    }
};

}  // namespace

Photometric photometric(const float* x, const float* y, const float* weight, const Recording* recording, int height, int width, float w_l1, float w_ssim,
                        float* grad, int threads) {
    const int n = width * kChannels;
    const double count = static_cast<double>(height) * n;
    const bool changed = weight || recording;
    std::vector<double> row_sum(height, 0.0), row_l1(height, 0.0), row_gain(size_t(height) * kChannels, 0.0), row_offset(size_t(height) * kChannels, 0.0);
    const int strips = std::clamp(height / kLeastStrip, 1, std::max(threads, 1));
    const size_t each = Strip::kRows * Strip::stride(n);
    KeptBuffer<Strip> buffer(strips * each + (changed ? size_t(height) * n : 0));
    float* recorded = buffer.data() + strips * each;
    const Recording how = recording ? *recording : Recording{};
#pragma omp parallel for num_threads(strips) schedule(static)
    for (int r = 0; r < (changed ? height : 0); ++r) {
        const int64_t at = int64_t(r) * n;
        recorded_row(x + at, y + at, weight ? weight + int64_t(r) * width : nullptr, how.gain, how.offset, width, recorded + at);
    }
    const Images images{changed ? recorded : x, y, weight, changed ? x : nullptr, how, grad, height, n, static_cast<float>(w_l1 / count), static_cast<float>(w_ssim / count),
                        row_sum.data(), row_l1.data(), row_gain.data(), row_offset.data()};
#pragma omp parallel for num_threads(strips) schedule(static)
    for (int k = 0; k < strips; ++k)
        Strip(images, buffer.data() + k * each).run(int(int64_t(height) * k / strips), int(int64_t(height) * (k + 1) / strips));
    Photometric result{};
    for (int r = 0; r < height; ++r) {
        result.ssim += row_sum[r];
        result.l1 += row_l1[r];
        for (int c = 0; c < kChannels; ++c) result.d_gain[c] += row_gain[r * kChannels + c], result.d_offset[c] += row_offset[r * kChannels + c];
    }
    result.ssim /= count;
    result.l1 /= count;
    return result;
}

}  // namespace e4dgs
