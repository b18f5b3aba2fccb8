// The rows of `photometric`: what each of its passes does to a few rows of [H,W,3] images, n = 3 W floats a row.
#pragma once

namespace e4dgs {

constexpr int kRadius = 5, kTaps = 2 * kRadius + 1;          // of the window
constexpr int kChannels = 3, kPad = kRadius * kChannels;     // kPad: floats on either side of a padded row
constexpr int kMoments = 4, kDerivatives = 3;  // SSIM needs E[xx] and E[yy] as a sum alone
constexpr int kTogether = 4;                                 // rows that go through the vertical window together: each value is loaded once for all
constexpr int kSpan = kTaps + kTogether - 1;                 // rows that they need
constexpr int kSpare = 8;                                    // floats after each row that may be overwritten

// Where the SSIM of a row goes, and its derivatives with respect to mu_x, E[xx], E[xy].
struct SsimRow {
    float *ssim, *d[kDerivatives];
};

// x, y, xx + yy, xy of one row through the horizontal window. scratch: a padded row whose pad is zero.
void moments_row(const float* x, const float* y, int n, float* const out[kMoments], float* scratch);

// From the moments of kSpan rows to kTogether rows of SSIM.
void ssim_rows(const float* const maps[kMoments][kSpan], int n, const SsimRow out[kTogether]);

// The derivatives of one row, padded, through the horizontal window.
void derivative_row(const float* const padded[kDerivatives], int n, float* const out[kDerivatives]);

// The sums over kTogether rows of SSIM and of |x - y|. Each is in the order of the row; together they take the time of one.
void sum_rows(const SsimRow rows[kTogether], const float* const x[kTogether], const float* const y[kTogether], int n, double ssim[kTogether],
              double l1[kTogether]);

// kTogether rows of the gradient, of which the last may be null. maps: what `derivative_row` made of kSpan rows.
void gradient_rows(const float* const x[kTogether], const float* const y[kTogether], const float* const maps[kDerivatives][kSpan], int n, float scale_l1,
                   float scale_ssim, float* const grad[kTogether]);

// gain * x + offset, of each channel; where the weight is 0, y. weight may be null: 1 everywhere.
void recorded_row(const float* x, const float* y, const float* weight, const float gain[kChannels], const float offset[kChannels], int pixels, float* out);

// Multiplies the gradient by the weight, unless that is null, and then by the gain. Adds to d_gain the sum of grad * x before the gain, to
// d_offset that of grad.
void weigh_row(const float* x, const float* weight, const float gain[kChannels], int pixels, float* grad, double d_gain[kChannels],
               double d_offset[kChannels]);

}  // namespace e4dgs
