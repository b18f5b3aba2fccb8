#include "arrivals.h"

#include <cmath>
#include <cstring>

namespace e4dgs {

void arrivals(const float* flow, int height, int width, float* out) {
    std::memset(out, 0, sizeof(float) * size_t(height) * size_t(width));
    for (int j = 0; j < height; ++j)
        for (int i = 0; i < width; ++i) {
            const float* v = flow + 2 * (int64_t(j) * width + i);
            const float x = float(i) + v[0], y = float(j) + v[1];
            if (!(x > -1.0f && x < float(width) && y > -1.0f && y < float(height))) continue;
            const int x0 = int(std::floor(x)), y0 = int(std::floor(y));
            const float fx = x - float(x0), fy = y - float(y0);
            for (int dy = 0; dy < 2; ++dy)
                for (int dx = 0; dx < 2; ++dx) {
                    const int to_x = x0 + dx, to_y = y0 + dy;
                    if (to_x < 0 || to_x >= width || to_y < 0 || to_y >= height) continue;
                    out[int64_t(to_y) * width + to_x] += (dx ? fx : 1.0f - fx) * (dy ? fy : 1.0f - fy);
                }
        }
}

}  // namespace e4dgs
