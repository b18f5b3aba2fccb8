#include "pool.h"

#include <algorithm>
#include <cstdint>
#include <cstdlib>
#include <fstream>
#include <limits>
#include <mutex>
#include <new>
#include <string>
#include <vector>

#if defined(__linux__)
#include <sys/mman.h>
#endif

namespace e4dgs {
namespace {

constexpr size_t kSmall = size_t(1) << 18;       // smaller buffers are left to malloc
constexpr size_t kHugePage = size_t(1) << 21;
#if defined(__SANITIZE_ADDRESS__)
constexpr size_t kMostKept = 0;  // no reuse, so that the sanitizer can watch the end of every buffer
#else
constexpr size_t kMostKept = size_t(512) << 20;  // bytes; memory beyond that is freed at once
#endif

std::mutex mutex;
std::vector<Memory> kept;
size_t kept_bytes = 0;

Memory allocate(size_t bytes) {
    const size_t alignment = bytes >= kHugePage && kMostKept ? kHugePage : 64;
    const size_t capacity = (bytes + alignment - 1) / alignment * alignment;
    void* data = std::aligned_alloc(alignment, capacity);
    if (!data) throw std::bad_alloc();
#if defined(__linux__) && defined(MADV_HUGEPAGE)
    if (alignment == kHugePage) madvise(data, capacity, MADV_HUGEPAGE);  // only a hint: everything works without it
#endif
    return {data, capacity};
}

#if defined(__linux__)
// Reads the first number after `key` in a file of the kernel's. Returns false if there is none ("max" in a control group).
bool number_in(const std::string& path, const std::string& key, size_t& value) {
    std::ifstream file(path);
    for (std::string word; file >> word;)
        if (word == key || key.empty()) {
            if (!key.empty() && !(file >> word)) return false;
            char* end;
            value = std::strtoull(word.c_str(), &end, 10);
            return end != word.c_str();
        }
    return false;
}

// What a control group has left of its limit. Pictures that were read stay in memory as cache and count as used, but they go when memory
// is needed.
size_t free_in_group(const std::string& folder, const char* most, const char* current, const std::string& prefix) {
    constexpr size_t kNone = std::numeric_limits<size_t>::max();
    size_t limit, used, cache, cached = 0;
    if (!number_in(folder + most, "", limit) || limit >= kNone / 4 || !number_in(folder + current, "", used)) return kNone;
    for (const char* kind : {"inactive_file", "active_file"})
        if (number_in(folder + "memory.stat", prefix + kind, cache)) cached += cache;
    used -= std::min(used, cached);
    return limit > used ? limit - used : 0;
}
#endif

}  // namespace

size_t free_memory(const std::string& root) {
    size_t free = std::numeric_limits<size_t>::max();
#if defined(__linux__)
    size_t kib;
    if (number_in(root + "/proc/meminfo", "MemAvailable:", kib)) free = kib * 1024;
    const std::string groups = root + "/sys/fs/cgroup/";
    free = std::min(free, free_in_group(groups, "memory.max", "memory.current", ""));
    free = std::min(free, free_in_group(groups + "memory/", "memory.limit_in_bytes", "memory.usage_in_bytes", "total_"));  // version 1
#endif
    return free;
}

Memory take_memory(size_t bytes) {
    if (bytes >= kSmall) {
        const std::lock_guard<std::mutex> lock(mutex);
        size_t best = kept.size();
        for (size_t i = 0; i < kept.size(); ++i)
            if (kept[i].capacity >= bytes && kept[i].capacity <= 2 * bytes && (best == kept.size() || kept[i].capacity < kept[best].capacity)) best = i;
        if (best < kept.size()) {
            const Memory found = kept[best];
            kept_bytes -= found.capacity;
            kept.erase(kept.begin() + std::ptrdiff_t(best));
            return found;
        }
    }
    return allocate(bytes);
}

void give_memory(Memory memory) {
    if (!memory.data) return;
    if (memory.capacity >= kSmall) {
        const std::lock_guard<std::mutex> lock(mutex);
        if (kept_bytes + memory.capacity <= kMostKept) {
            try {
                kept.push_back(memory);
                kept_bytes += memory.capacity;
                return;
            } catch (const std::bad_alloc&) {  // then the memory is freed below
            }
        }
    }
    std::free(memory.data);
}

size_t most_kept_memory() { return kMostKept; }

size_t release_memory() {
    const std::lock_guard<std::mutex> lock(mutex);
    const size_t bytes = kept_bytes;
    for (const Memory& memory : kept) std::free(memory.data);
    kept.clear();
    kept_bytes = 0;
    return bytes;
}

}  // namespace e4dgs
