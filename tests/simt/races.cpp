#include "races.h"

#include <algorithm>
#include <utility>

namespace simt {

Races races;
bool watching = false;

void Races::start_launch(const char* stacks, size_t stack_bytes, const char* shared, size_t shared_bytes) {
    stacks_ = uintptr_t(stacks), stack_bytes_ = stack_bytes, shared_ = uintptr_t(shared), shared_bytes_ = shared_bytes;
    words_.clear(), overwrites_.clear();
}

// Each of these lanes learns what any of them knows.
void Races::order_lanes(const Warp& w, uint32_t lanes) {
    uint32_t(*const times)[kWarp] = time_ + (&w - block.warps) * kWarp;
    uint32_t known[kWarp] = {};
    for (uint32_t rest = lanes; rest; rest &= rest - 1) {
        const int lane = lane_of(rest);
        ++times[lane][lane];
        for (int i = 0; i < kWarp; ++i) known[i] = std::max(known[i], times[lane][i]);
    }
    for (uint32_t rest = lanes; rest; rest &= rest - 1) std::copy_n(known, kWarp, times[lane_of(rest)]);
}

bool Races::is_ordered(const Access& before, const Access& now) const {
    if (before.block != now.block) return false;
    if (before.thread == now.thread || before.epoch != now.epoch) return true;
    return before.thread / kWarp == now.thread / kWarp && time_[now.thread][before.thread % kWarp] > before.time;
}

void Races::access(uintptr_t at, size_t bytes, bool writes, bool atomic, uintptr_t by) {
    const uintptr_t library = uintptr_t(&__ehdr_start);
    if (at - stacks_ < stack_bytes_ || at - library < uintptr_t(&end) - library) return;  // a thread's own, or the emulator's
    settle();
    block.busy = true;
    const uint16_t thread = uint16_t(threadIdx.x);
    const Access now = {blockIdx.x, epoch_, time_[thread][thread % kWarp], thread, atomic, by};
    for (const uintptr_t end = at + bytes; at < end;) {
        const uintptr_t next = std::min(end, (at / 4 + 1) * 4);
        std::vector<Byte>& parts = words_[at / 4];
        if (parts.empty()) parts.resize(1);
        if (parts.size() == 1 && next - at < 4) parts.assign(4, Byte(parts[0]));
        if (parts.size() == 1)
            access(at, int(next - at), parts[0], now, writes);
        else
            for (uintptr_t i = at; i < next; ++i) access(i, 1, parts[i % 4], now, writes);
        at = next;
    }
    block.busy = false;
}

// What comes before this in order, and whoever races with it races with this too, need not be kept.
void Races::check(uintptr_t at, int bytes, std::vector<Access>& all, bool wrote, const Access& now, bool writes) {
    const bool replaces = writes || !wrote;
    size_t kept = 0;
    for (const Access& before : all) {
        if (is_shared(at) && before.block != now.block) continue;  // it was another block's memory
        const bool ordered = is_ordered(before, now);
        const bool races = !ordered && (wrote || writes) && !(before.atomic && now.atomic);
        if (races && wrote && writes)
            for (int i = 0; i < bytes; ++i) overwrites_.push_back({at + i, *reinterpret_cast<const char*>(at + i), before, now});
        else if (races)
            report(at, before, wrote, now, writes);
        if (!(ordered && replaces && (before.atomic || !now.atomic))) all[kept++] = before;
    }
    all.resize(kept);
}

void Races::settle() {
    for (const Overwrite& one : overwrites_)
        if (*reinterpret_cast<const char*>(one.at) != one.old) report(one.at, one.before, true, one.now, true);
    overwrites_.clear();
}

void Races::access(uintptr_t at, int bytes, Byte& byte, const Access& now, bool writes) {
    check(at, bytes, byte.writes, true, now, writes);
    check(at, bytes, byte.reads, false, now, writes);
    std::vector<Access>& all = writes ? byte.writes : byte.reads;
    // Whatever is unordered with this read is so with one of two in different warps, too.
    const auto warp_of = [](const Access& one) { return std::pair(one.block, one.thread / kWarp); };
    const auto elsewhere = [&](const Access& other) { return warp_of(other) != warp_of(all[0]); };
    if (!writes && !now.atomic && std::any_of(all.begin(), all.end(), elsewhere)) return;
    all.push_back(now);
}

std::string Races::place(uintptr_t at) const {
    if (is_shared(at)) return describe_shared(at - shared_);
    const Parameter* nearest = nullptr;
    uintptr_t start = 0;
    for (int i = 0; i < block.kernel->n_parameters; ++i) {
        const Parameter& parameter = block.kernel->parameters[i];
        if (parameter.passed != 'p') continue;
        const uintptr_t begin = *static_cast<const uintptr_t*>(block.arguments[i]);
        if (begin <= at && begin > start) nearest = &parameter, start = begin;
    }
    return nearest ? "byte " + std::to_string(at - start) + " of " + nearest->name : "memory of nobody";
}

void Races::report(uintptr_t at, const Access& before, bool wrote, const Access& now, bool writes) const {
    block.error = "race: " + describe_thread() + (writes ? " writes " : " reads ") + place(at) + ", at " + describe_instruction(now.by);
    block.error += "; thread " + std::to_string(before.thread);
    if (before.block != now.block) block.error += " of block " + std::to_string(before.block);
    block.error += wrote ? " wrote it, at " : " read it, at ";
    block.error += describe_instruction(before.by) + ", and nothing orders the two";
    block.busy = false;
    leave();
}

}  // namespace simt
