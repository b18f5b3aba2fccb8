// L1 and SSIM (11-tap Gaussian window, sigma 1.5, zero padding, as 3D Gaussian Splatting uses them) with the gradient in one call.
#pragma once

namespace e4dgs {

struct Photometric {
    double l1;    // mean |x - y|
    double ssim;  // mean SSIM over pixels and channels
    double d_gain[3], d_offset[3];  // d(w_l1 * l1 + w_ssim * (1 - ssim)) / d gain and offset
};

// How a camera records colours: gain * colour + offset, of each channel.
struct Recording {
    float gain[3] = {1, 1, 1}, offset[3] = {0, 0, 0};
};

// recording: of x, or null if x is already what the camera would record. x, y [H,W,3]; grad [H,W,3] receives
// d(w_l1 * l1 + w_ssim * (1 - ssim)) / dx. weight [H,W], or null: factor on the gradient of each pixel; where it is 0, x as recorded is
// taken to equal y. Bit-equal for any number of threads.
Photometric photometric(const float* x, const float* y, const float* weight, const Recording* recording, int height, int width, float w_l1, float w_ssim,
                        float* grad, int threads);

}  // namespace e4dgs
