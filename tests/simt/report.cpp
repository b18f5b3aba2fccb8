// What a deadlock says: who waits where, for whom.
#include <cstdio>
#include <cstring>

#include "block.h"

namespace simt {

const char* name_of(Meeting meeting) {
    static const char* const names[] = {
        "__shfl_sync", "__shfl_up_sync", "__shfl_down_sync", "__shfl_xor_sync", "__ballot_sync", "__any_sync", "__all_sync",
        "__match_any_sync", "__syncwarp", "__syncthreads", "__syncthreads_or", "__syncthreads_and", "__syncthreads_count"};
    return names[int(meeting)];
}

bool same_file(const char* a, const char* b) { return !std::strcmp(a, b); }

std::string describe_thread() {
    return "warp " + std::to_string(threadIdx.x / kWarp) + ": lane " + std::to_string(threadIdx.x % kWarp) + " (thread " +
           std::to_string(threadIdx.x) + ")";
}

std::string describe_place(const Place& place) {
    const char* slash = std::strrchr(place.file_name(), '/');
    return std::string(slash ? slash + 1 : place.file_name()) + ":" + std::to_string(place.line());
}

std::string describe_instruction(uintptr_t at) {
    char text[32];
    std::snprintf(text, sizeof text, "<%#zx>", size_t(at - uintptr_t(&__ehdr_start)));
    return text;
}

std::string describe_shared(size_t offset) {
    char text[32];
    std::snprintf(text, sizeof text, "{0x%zx}", offset);
    return text;
}

namespace {

std::string hexadecimal(uint32_t bits) {
    char text[16];
    std::snprintf(text, sizeof text, "0x%08x", bits);
    return text;
}

// "3", "0-15", "0-3,8,10-11"
std::string ranges(uint32_t bits) {
    std::string text;
    for (int first = 0; first < kWarp; ++first) {
        if (!(bits >> first & 1)) continue;
        int last = first;
        while (last + 1 < kWarp && bits >> (last + 1) & 1) ++last;
        text += (text.empty() ? "" : ",") + std::to_string(first) + (last > first ? "-" + std::to_string(last) : "");
        first = last;
    }
    return text;
}

std::string lanes(uint32_t bits) { return (bits & (bits - 1) ? "lanes " : "lane ") + ranges(bits); }

std::string state_of(const Warp& w, int lane) {
    if (!(w.present >> lane & 1)) return "not there (the block has no such thread)";
    if (w.ended >> lane & 1) return "ended";
    const Thread& t = w.lanes[lane];
    const std::string where = std::string(name_of(t.meeting)) + " at " + describe_place(t.place);
    return w.at_barrier >> lane & 1 ? where : where + ", mask " + hexadecimal(t.mask);
}

}  // namespace

std::string describe(const Warp& w) {
    std::string text = "warp " + std::to_string(&w - block.warps) + " cannot go on: ";
    const char* between = "";
    for (uint32_t rest = ~0u; rest;) {
        const std::string state = state_of(w, lane_of(rest));
        uint32_t same = 0;
        for (int lane = 0; lane < kWarp; ++lane)
            if (rest >> lane & 1 && state_of(w, lane) == state) same |= 1u << lane;
        rest &= ~same;
        text += between + lanes(same) + ": " + state;
        between = "; ";
    }
    return text;
}

std::string describe_block() {
    std::string text = "only a part of the block is at each barrier";
    for (int i = 0; i < block.n_warps; ++i) text += "; " + describe(block.warps[i]);
    return text;
}

}  // namespace simt
