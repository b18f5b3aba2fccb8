// What is rendered of primitives, from what is learned: sizes, opacities, and colours under the light of a time.
#pragma once
#include <cstdint>

namespace e4dgs {

// N primitives. logs [N,width]; others [N] or null; logits [N]; dc [N,3]; rest [N,stored,3], of which the first `shown` are used;
// shades [N,courses] and light [courses], or both null.
struct Looks {
    int64_t n, width, stored, shown, courses;
    const float *logs, *others, *logits, *dc, *rest, *shades, *light;
};

// sizes [N,width], other_sizes [N], opacities [N], sh [N,1 + shown,3]: as results, or the gradients of these. Null if there is none.
template <class T>
struct Drawn {
    T *sizes, *other_sizes, *opacities, *sh;
};

// Gradients of what `Looks` holds, each null if nothing comes in for it.
struct LooksGrad {
    float *logs, *others, *logits, *dc, *rest, *shades, *light;
};

void looks_forward(const Looks& in, const Drawn<float>& out, int threads);

// out: the results of the forward pass. Bit-equal for any number of threads.
void looks_backward(const Looks& in, const Drawn<const float>& out, const Drawn<const float>& grads, const LooksGrad& back, int threads);

}  // namespace e4dgs
