// The part of the backward pass that both kinds share: the slots of a primitive are summed in tile order, in double, and rows of primitives
// that no tile touched become zero. Included by project.inl.

inline void clear_row(float* to, int64_t i, int width) {
    if (to) __builtin_memset(to + i * width, 0, sizeof(float) * size_t(width));
}

inline void zero_looks(const Looks& in, const LooksGrad& out, int extras, int64_t i) {
    clear_row(out.opacities, i, 1), clear_row(out.colors, i, 3);
    clear_row(out.sh, i, (in.degree + 1) * (in.degree + 1) * 3), clear_row(out.extras, i, extras);
}

// Returns false if no tile touched the primitive. count: number of floats in a slot before the extras.
template <class Job>
__attribute__((always_inline)) inline bool sum_slots(const Job& job, int64_t i, int count, double* sums) {
    bool any = false;
    for (uint64_t s = job.slot_begin[i]; s < job.slot_begin[i + 1]; s += job.units) {
        if (!job.touched[s]) continue;
        const float* slot = job.slots + 4 * s;
        if (!any)
            for (int c = 0; c < count; ++c) sums[c] = 0.0;
        for (int c = 0; c < count; ++c) sums[c] += double(slot[c]);
        any = true;
    }
    if (!any || !job.out.extras) return any;
    const int extras = job.scene->extras;
    for (int e = 0; e < extras; ++e) {
        double total = 0.0;
        for (uint64_t s = job.slot_begin[i]; job.extras && s < job.slot_begin[i + 1]; s += job.units)
            if (job.touched[s]) total += double(job.slots[4 * s + uint64_t(count + e)]);
        job.out.extras[i * extras + e] = float(total);
    }
    return true;
}

// A gradient beyond float32's range (from scales near the end of it) becomes the largest float, not an infinity.
__attribute__((always_inline)) inline void write_rows(float* to, const Pack* from, int width, const int64_t* index, const bool* mine) {
    if (!to) return;
    alignas(64) double lane[3 * kMaxPoints][kLanes];
    for (int j = 0; j < width; ++j) store_lanes(larger(smaller(from[j], Pack(kLargest)), Pack(-kLargest)), lane[j]);
    for (int l = 0; l < kLanes; ++l)
        for (int j = 0; mine[l] && j < width; ++j) to[index[l] * width + j] = float(lane[j][l]);
}

inline double sum_of_lanes(Pack a) {
    double sum = 0.0;
    for (int l = 0; l < kLanes; ++l) sum += a.v[l];
    return sum;
}

// Calls f(grad). If the camera's gradient is not needed, grad costs nothing.
template <class F>
void with_camera_grad(double* camera, F&& f) {
    if (!camera) {
        NoCameraGrad nothing;
        return f(nothing);
    }
    CameraGrad<Pack> grad;
    grad.fx = grad.fy = grad.cx = grad.cy = Pack(0);
    for (Pack& r : grad.R) r = Pack(0);
    for (Pack& t : grad.t) t = Pack(0);
    f(grad);
    camera[0] = sum_of_lanes(grad.fx), camera[1] = sum_of_lanes(grad.fy), camera[2] = sum_of_lanes(grad.cx), camera[3] = sum_of_lanes(grad.cy);
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) camera[4 + 4 * i + j] = sum_of_lanes(grad.R[3 * i + j]);
        camera[4 + 4 * i + 3] = sum_of_lanes(grad.t[i]);
    }
}

// Kind provides kMost, the largest number of sums; shape(job, i), their number in a slot; zero(job, i); and lanes(job, camera, index, mine,
// sums [kMost][lanes], grad), where lanes that are not `mine` repeat another row with sums of zero. A primitive's lane depends only on its
// index, because other primitives must not change a single bit, not even of the camera's gradient.
template <class Kind, class Job, class G>
void backproject(const Job& job, int64_t first, int64_t last, G& grad) {
    const Camera<Pack> camera = camera_of(job.scene->camera);
    for (int64_t at = first; at < last; at += kLanes) {
        int64_t index[kLanes], touched = -1;
        alignas(64) double sums[Kind::kMost][kLanes] = {};
        bool mine[kLanes];
        for (int l = 0; l < kLanes; ++l) {
            const int64_t i = index[l] = at + l;
            mine[l] = false;
            if (i >= last) continue;
            double one[Kind::kMost];
            const int count = Kind::shape(job, i);
            mine[l] = sum_slots(job, i, count, one);
            if (!mine[l]) {
                Kind::zero(job, i);
                continue;
            }
            touched = i;
            for (int c = 0; c < count; ++c) sums[c][l] = one[c];
        }
        if (touched < 0) continue;
        for (int l = 0; l < kLanes; ++l)
            if (!mine[l]) index[l] = touched;
        Kind::lanes(job, camera, index, mine, sums, grad);
    }
}
