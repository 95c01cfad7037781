// One Gaussian through a camera, in double precision: its footprint, colour, depth, and their adjoint.
#pragma once

#include "mphygs/splatting/splatting.hpp"

namespace mphygs {

inline constexpr double least_alpha = 1.0 / 255.0;

/// Where Gaussian `i` falls; false where it reaches no pixel. values: red, green, blue, depth.
bool project_gaussian(const SplatCamera& camera, const SplatGaussians& gaussians, std::size_t i, Splat& splat, float values[4]);

/// What backward of a picture says of one splat.
struct SplatBar {
    double x = 0, y = 0, a = 0, b = 0, c = 0, opacity = 0;
    double values[4]{};  // red, green, blue, depth
};

/// Writes the gradient of Gaussian `i` (features excepted) into the arrays of `gradient`.
void project_gaussian_reverse(const SplatCamera& camera, const SplatGaussians& gaussians, std::size_t i, const SplatBar& bar,
                              SplatGradient& gradient);

}  // namespace mphygs
