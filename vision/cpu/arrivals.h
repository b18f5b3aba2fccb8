// Where the pixels of a picture land along their flow.
#pragma once
#include <cstdint>

namespace e4dgs {

// flow [height, width, 2] px. out [height, width]: how many pixels land on each, shared bilinearly; what lands outside counts for nobody,
// and neither does a vector that is not finite.
void arrivals(const float* flow, int height, int width, float* out);

}  // namespace e4dgs
