// Loops whose results have the same bits at any thread count.
//
// The work is cut into a fixed number of chunks that depends on the problem alone; what chunks
// produce together is summed in the order of the chunks.
#pragma once

#include <omp.h>

#include <cstddef>

namespace mphygs {

template <class F>
inline void for_each_index(int count, int threads, F&& f) {
    if (threads <= 1 || count <= 1) {
        for (int i = 0; i < count; ++i) {
            f(i);
        }
        return;
    }
#pragma omp parallel for num_threads(threads) schedule(static, 1)
    for (int i = 0; i < count; ++i) {
        f(i);
    }
}

/// First index of part `i` of `parts` equal parts of [0, count).
inline std::size_t part_begin(std::size_t count, int parts, int i) {
    return count * static_cast<std::size_t>(i) / static_cast<std::size_t>(parts);
}

}  // namespace mphygs
