// Structural similarity of two pictures (Wang et al. 2004) with its gradient.
#pragma once

#include <vector>

namespace mphygs {

struct Similarity {
    double value = 0;             // mean over pixels and channels
    std::vector<float> first_bar; // its derivative with respect to the first picture
};

/// first, second: (channel, row, column), 0 to 1. Gaussian window of 11 pixels, standard deviation 1.5, zero
/// beyond the edge, as in 3DGS. The same bits at any thread count.
Similarity structural_similarity(const float* first, const float* second, int channels, int height, int width, int threads);

}  // namespace mphygs
