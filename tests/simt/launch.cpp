// What Python calls: the kernels of this library, and one launch of one of them.
#include <link.h>
#include <sys/mman.h>
#include <unistd.h>

#include <cstring>
#include <numeric>
#include <utility>
#include <vector>

#include "faults.h"
#include "races.h"

extern "C" void* __tls_get_addr(size_t* module_and_offset);  // the dynamic linker's

namespace simt {

void run_thread();
void run_block();

namespace {

// Stacks for all threads of a block, kept for the next launch, with a page below them that nobody may touch: what recurses without end
// comes there through the others' stacks. Single frames that are too large do not compile (compiler.py). The tops lie at
// different distances from a page's start, or all threads would share a few lines of the cache.
class Stacks {
public:
    bool provide(int n) {
        if (n <= n_) return true;
        if (n_) munmap(memory_, bytes_);
        page_ = sysconf(_SC_PAGESIZE), n_ = 0, bytes_ = page_ + n * kStride;
        memory_ = static_cast<char*>(mmap(nullptr, bytes_, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS | MAP_NORESERVE, -1, 0));
        if (memory_ == MAP_FAILED) return false;
        mprotect(memory_, page_, PROT_NONE);
        n_ = n;
        return true;
    }
    const char* low() const { return memory_; }
    const char* high() const { return memory_ + bytes_; }
    char* bottom(int i) const { return memory_ + page_ + i * kStride; }
    size_t bytes(int i) const { return kStride - i * 320 % 4096 / 64 * 64; }

private:
    static constexpr size_t kStride = 256 << 10;
    int n_ = 0;
    size_t page_ = 0, bytes_ = 0;
    char* memory_ = nullptr;
};
Stacks stacks;

// The __shared__ variables of all kernels of this library: its only thread-local ones (simt.h), in this thread.
struct Shared {
    char* begin = nullptr;
    size_t bytes = 0;

    Shared() { dl_iterate_phdr(find, this); }

private:
    static int find(dl_phdr_info* library, size_t, void* self) {
        if (library->dlpi_addr != uintptr_t(&__ehdr_start)) return 0;
        for (int i = 0; i < library->dlpi_phnum; ++i) {
            if (library->dlpi_phdr[i].p_type != PT_TLS) continue;
            size_t first[] = {library->dlpi_tls_modid, 0};
            *static_cast<Shared*>(self) = {static_cast<char*>(__tls_get_addr(first)), library->dlpi_phdr[i].p_memsz};
        }
        return 1;
    }
    Shared(char* begin, size_t bytes) : begin(begin), bytes(bytes) {}
};

void prepare_block(uint32_t index, int threads, const Shared& shared) {
    if (shared.bytes) std::memset(shared.begin, 0xff, shared.bytes);
    races.order_block();
    blockIdx = {index, 0, 0};
    block.n_warps = (threads + kWarp - 1) / kWarp;
    for (int i = 0; i < block.n_warps; ++i) {
        Warp& w = block.warps[i];
        const int n = std::min(kWarp, threads - i * kWarp);
        w.present = w.ready = n == kWarp ? ~0u : (1u << n) - 1;
        w.waiting = w.at_barrier = w.ended = 0;
        for (int lane = 0; lane < n; ++lane) {
            const int thread = i * kWarp + lane;
            prepare(w.lanes[lane].fiber, stacks.bottom(thread), stacks.bytes(thread), run_thread);
        }
    }
}

void run_grid(uint32_t blocks, int threads, uint64_t seed, double seconds) {
    if (!stacks.provide(threads)) {
        block.error = "no memory for the threads' stacks";
        return;
    }
    const Shared shared;
    const Faults faults(stacks.low(), stacks.high(), seconds);
    races.start_launch(stacks.low(), stacks.high() - stacks.low(), shared.begin, shared.bytes);
    std::vector<uint32_t> order(blocks);
    std::iota(order.begin(), order.end(), 0u);
    block.shuffled = seed != 0, block.random = {seed};
    if (block.shuffled)
        for (uint32_t i = blocks - 1; i > 0; --i) std::swap(order[i], order[block.random.below(i + 1)]);
    for (const uint32_t index : order) {
        prepare_block(index, threads, shared);
        run_block();
        if (!block.error.empty()) {
            block.error = "block " + std::to_string(index) + ", " + block.error;
            return;
        }
    }
}

}  // namespace
}  // namespace simt

#define SIMT_EXPORT extern "C" __attribute__((visibility("default")))

SIMT_EXPORT const simt::Kernel* simt_kernels(int* n) {
    *n = simt::n_kernels;
    return simt::kernels;
}

// Null, or what went wrong; the text lasts until the next launch.
SIMT_EXPORT const char* simt_launch(int kernel, uint32_t blocks, uint32_t threads, void** arguments, uint64_t seed, double seconds) {
    using simt::block;
    block.kernel = &simt::kernels[kernel];
    block.arguments = arguments;
    block.error.clear(), block.busy = false;
    blockDim = {threads, 1, 1}, gridDim = {blocks, 1, 1};
    simt::run_grid(blocks, int(threads), seed, seconds);
    return block.error.empty() ? nullptr : block.error.c_str();
}
