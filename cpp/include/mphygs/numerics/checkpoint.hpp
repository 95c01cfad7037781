// Reverse sweep over a long chain of steps within a memory budget.
//
// Half of the budget holds full records of the steps that are being reversed (a leaf), the other
// half checkpoints to restart from. A range that has more leaves than checkpoints is cut again,
// so any budget that holds one record works; a smaller budget only costs more recomputation.
#pragma once

#include <algorithm>
#include <cstddef>
#include <vector>

namespace mphygs {

/// Calls `backward(n, record)` for n = steps-1 .. 0 with the record of step n. The simulation
/// stands at step 0 when called. Returns the number of forward steps computed; before the first call of `backward` each
/// is computed once, in order, and nothing is restored.
template <class Save, class Restore, class Forward, class ForwardRecorded, class Backward>
long reverse_all(int steps, std::size_t state_bytes, std::size_t record_bytes, std::size_t budget, Save&& save,
                 Restore&& restore, Forward&& forward, ForwardRecorded&& forward_recorded, Backward&& backward) {
    using State = decltype(save());
    const int leaf = static_cast<int>(std::clamp<std::size_t>(budget / 2 / record_bytes, 1, static_cast<std::size_t>(std::max(steps, 1))));
    const int slots = static_cast<int>(std::min<std::size_t>(budget / 2 / state_bytes, 1u << 20));
    long computed = 0;

    // Reverses [begin, end), the simulation standing at `begin`; may keep `free_slots` states.
    const auto range = [&](auto&& self, int begin, int end, int free_slots) -> void {
        if (end - begin <= leaf) {
            std::vector<State> records;
            records.reserve(static_cast<std::size_t>(end - begin));
            for (int n = begin; n < end; ++n) {
                records.push_back(forward_recorded(n));
                ++computed;
            }
            for (int n = end - 1; n >= begin; --n) {
                backward(n, records[static_cast<std::size_t>(n - begin)]);
                records.pop_back();
            }
            return;
        }
        const int leaves = (end - begin + leaf - 1) / leaf;
        // All pieces become leaves where the slots allow, else half of the slots are spent here.
        const int pieces = leaves <= free_slots + 1 ? leaves : std::clamp(free_slots / 2, 2, leaves);
        std::vector<State> starts;
        std::vector<int> bounds;
        for (int p = 0; p <= pieces; ++p) {
            bounds.push_back(begin + static_cast<int>((static_cast<long>(end - begin) * p) / pieces));
        }
        for (int p = 0; p + 1 < pieces; ++p) {
            starts.push_back(save());
            for (int n = bounds[static_cast<std::size_t>(p)]; n < bounds[static_cast<std::size_t>(p) + 1]; ++n) {
                forward(n);
                ++computed;
            }
        }
        for (int p = pieces - 1; p >= 0; --p) {
            if (p + 1 < pieces) {
                restore(starts[static_cast<std::size_t>(p)]);
                starts.pop_back();
            }
            self(self, bounds[static_cast<std::size_t>(p)], bounds[static_cast<std::size_t>(p) + 1],
                 std::max(0, free_slots - static_cast<int>(starts.size())));
        }
    };
    range(range, 0, steps, slots);
    return computed;
}

}  // namespace mphygs
