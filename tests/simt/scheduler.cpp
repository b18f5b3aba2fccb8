// Who runs next. A round lets every lane of one warp that can go on do so until it meets others or ends; then the meetings that all
// their lanes have reached take place. When no warp can go on, the block's barrier opens, or this is a deadlock.
#include "races.h"

uint3 threadIdx, blockIdx;
dim3 blockDim, gridDim;

namespace simt {

Block block;

namespace {

bool same_meeting(const Thread& a, const Thread& b) { return a.meeting == b.meeting && a.mask == b.mask && same_place(a.place, b.place); }

uint32_t lanes_like(const Warp& w, uint32_t among, const Thread& thread) {
    uint32_t found = 0;
    for (uint32_t rest = among; rest; rest &= rest - 1)
        if (same_meeting(w.lanes[lane_of(rest)], thread)) found |= rest & -rest;
    return found;
}

void hold_meeting(Warp& w, uint32_t lanes, Meeting meeting) {
    uint64_t votes = 0;
    const bool vote = meeting == Meeting::ballot || meeting == Meeting::any || meeting == Meeting::all;
    if (vote)
        for (uint32_t rest = lanes; rest; rest &= rest - 1) votes |= w.brought[lane_of(rest)] << lane_of(rest);
    for (uint32_t rest = lanes; rest; rest &= rest - 1) w.met[lane_of(rest)] = vote ? votes : w.brought[lane_of(rest)];
    w.waiting &= ~lanes, w.ready |= lanes;
    if (watching && meeting == Meeting::syncwarp) races.order_lanes(w, lanes);
}

void hold_meetings(Warp& w) {
    bool held = false;
    for (uint32_t rest = w.waiting; rest;) {
        const Thread& first = w.lanes[lane_of(rest)];
        const uint32_t same = lanes_like(w, rest, first);
        rest &= ~same;
        if (same == first.mask)
            hold_meeting(w, same, first.meeting), held = true;
        else if (first.mask & (w.ended | ~w.present))
            block.error = describe(w), leave();
    }
    if (w.waiting && !held) block.error = describe(w), leave();
}

// All threads that have not ended wait at a barrier.
void open_barrier() {
    const Thread* first = nullptr;
    block.count = {0, 0};
    for (int i = 0; i < block.n_warps; ++i) {
        Warp& w = block.warps[i];
        for (uint32_t rest = w.at_barrier; rest; rest &= rest - 1) {
            const int lane = lane_of(rest);
            if (!first) first = &w.lanes[lane];
            if (!same_meeting(*first, w.lanes[lane])) block.error = describe_block(), leave();
            ++block.count.all, block.count.those += w.brought[lane] != 0;
        }
    }
    for (int i = 0; i < block.n_warps; ++i) block.warps[i].ready = block.warps[i].at_barrier, block.warps[i].at_barrier = 0;
    block.keep_to_warp = !block.shuffled || block.random.below(2);
    races.order_block();
}

// A warp with lanes that can go on, or null.
Warp* choose_warp() {
    if (block.keep_to_warp && block.warp && block.warp->ready) return block.warp;
    int candidates[kMaxThreads / kWarp], n = 0;
    for (int i = 0; i < block.n_warps; ++i)
        if (block.warps[i].ready) candidates[n++] = i;
    return n ? &block.warps[candidates[block.shuffled ? block.random.below(n) : 0]] : nullptr;
}

void start_round() {
    if (block.warp) hold_meetings(*block.warp);
    Warp* w = choose_warp();
    if (!w) {
        open_barrier();
        block.warp = nullptr, w = choose_warp();
    }
    block.warp = w, block.at = 0, block.n_order = 0;
    if (!w) return;
    for (uint32_t rest = w->ready; rest; rest &= rest - 1) block.order[block.n_order++] = lane_of(rest);
    if (block.shuffled)
        for (int i = block.n_order - 1; i > 0; --i) std::swap(block.order[i], block.order[block.random.below(i + 1)]);
}

// The thread that runs stops; returns when it is its turn again.
void stop(Thread& self) {
    if (watching) races.settle();
    if (++block.at >= block.n_order) start_round();
    Fiber* next = &block.launcher;
    if (block.warp) {
        const int lane = block.order[block.at];
        threadIdx.x = unsigned(block.warp - block.warps) * kWarp + lane;
        next = &block.warp->lanes[lane].fiber;
    }
    if (next != &self.fiber) transfer(self.fiber, *next);
}

}  // namespace

const uint64_t* meet(Meeting meeting, uint32_t mask, uint64_t brought, const Place& place) {
    Warp& w = *block.warp;
    const uint32_t lane = threadIdx.x % kWarp, bit = 1u << lane;
    if (!(mask & bit)) fail("is not in the mask it gives", place);
    Thread& self = w.lanes[lane];
    self.meeting = meeting, self.mask = mask, self.place = place;
    w.brought[lane] = brought, w.waiting |= bit, w.ready &= ~bit;
    stop(self);
    return w.met;
}

Count gather(Meeting meeting, bool predicate, const Place& place) {
    Warp& w = *block.warp;
    const uint32_t lane = threadIdx.x % kWarp, bit = 1u << lane;
    Thread& self = w.lanes[lane];
    self.meeting = meeting, self.mask = 0, self.place = place;
    w.brought[lane] = predicate, w.at_barrier |= bit, w.ready &= ~bit;
    stop(self);
    return block.count;
}

// The first function of every fiber.
void run_thread() {
    block.kernel->call(block.arguments);
    Warp& w = *block.warp;
    const uint32_t lane = threadIdx.x % kWarp, bit = 1u << lane;
    w.ready &= ~bit, w.ended |= bit;
    stop(w.lanes[lane]);
}

// Runs the block whose threads are prepared; returns when all have ended or one has failed.
void run_block() {
    block.warp = nullptr;
    block.at = block.n_order = 0;
    block.keep_to_warp = !block.shuffled || block.random.below(2);
    start_round();
    threadIdx.x = unsigned(block.warp - block.warps) * kWarp + block.order[0];
    transfer(block.launcher, block.warp->lanes[block.order[0]].fiber);
}

void leave() {
    Fiber abandoned;
    transfer(abandoned, block.launcher);
    __builtin_unreachable();
}

void fail(const char* what, const Place& place) {
    block.error = describe_thread() + " " + what + ", at " + describe_place(place);
    leave();
}

}  // namespace simt
