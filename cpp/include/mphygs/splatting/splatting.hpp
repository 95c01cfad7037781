// Gaussian splatting: anisotropic 3D Gaussians projected (EWA, Zwicker et al. 2001) and composited front to
// back in tiles (Kerbl et al. 2023), with the gradient with respect to every Gaussian's numbers.
//
// The same bits at any thread count: a tile is one piece of work, and what the tiles say of a Gaussian is
// summed in the order of its tiles.
#pragma once

#include <cstdint>
#include <vector>

namespace mphygs {

/// OpenCV axes (x right, y down, z forward); the first pixel's centre is at (0.5, 0.5) [px].
struct SplatCamera {
    int width = 0, height = 0;
    double focal[2]{};               // [px]
    double centre[2]{};              // principal point [px]
    double camera_from_world[3][4]{};
    double nearest = 0.01;           // Gaussians nearer than this are not drawn [m]
    double blur = 0.3;               // added to the projected covariance [px^2]
};

/// N Gaussians, arrays of the caller's that outlive the call.
struct SplatGaussians {
    std::size_t count = 0;
    int harmonic_count = 1;                // (degree + 1)^2, degree 0 to 3
    int feature_count = 0;
    const float* positions = nullptr;      // (N, 3) [m]
    const float* rotations = nullptr;      // (N, 4) wxyz, of any length
    const float* scales = nullptr;         // (N, 3) [m]
    const float* opacities = nullptr;      // (N,)
    const float* harmonics = nullptr;      // (N, K, 3)
    const float* features = nullptr;       // (N, F)
    const float* screen_offsets = nullptr; // (N, 2) [px], added to the projected centres; may be null
};

/// Derivatives of a scalar with respect to the arrays of SplatGaussians, shaped like them.
struct SplatGradient {
    std::vector<float> positions, rotations, scales, opacities, harmonics, features, screen_offsets;
};

/// One Gaussian as the picture sees it. alpha = min(0.99, opacity exp(-s)) where s <= reach, else nothing,
/// s = (a dx^2 + c dy^2) / 2 + b dx dy.
struct Splat {
    float x, y;                         // centre [px]
    float a, b, c;                      // inverse covariance [1/px^2]
    float opacity;
    float reach;                        // ln(255 opacity): beyond it alpha is below 1/255
    std::int32_t column[2], row[2];     // pixels it can reach, [begin, end)
};

/// One picture: made by the constructor, differentiated as often as wanted.
class SplatPass {
public:
    static constexpr int tile_size = 16;

    SplatPass(const SplatCamera& camera, const SplatGaussians& gaussians, int threads);

    /// Red, green, blue, depth [m], then features: sums over Gaussians weighted by what is seen of them,
    /// (channel, row, column).
    const std::vector<float>& image() const { return image_; }
    /// What the Gaussians let through of what lies behind them, (row, column).
    const std::vector<float>& transmittance() const { return transmittance_; }
    /// Gaussians that reach the picture, nearest first.
    const std::vector<std::int32_t>& order() const { return order_; }
    int channel_count() const { return channels_; }
    const SplatCamera& camera() const { return camera_; }

    /// image_bar, transmittance_bar: derivatives of a scalar with respect to image() and transmittance().
    SplatGradient backward(const SplatGaussians& gaussians, const float* image_bar, const float* transmittance_bar, int threads) const;

private:
    void project(const SplatGaussians& gaussians, int threads);
    void assign_tiles();

    SplatCamera camera_;
    int channels_, tile_columns_, tile_rows_;
    std::vector<std::int32_t> order_;      // rank -> Gaussian
    std::vector<Splat> splats_;            // by rank
    std::vector<float> values_;            // (rank, channel)
    std::vector<std::size_t> slot_begin_;  // rank -> its first (rank, tile) pair
    std::vector<std::size_t> tile_begin_;  // tile -> its first entry
    std::vector<std::int32_t> entry_rank_; // entries, nearest first within a tile
    std::vector<std::size_t> entry_slot_;
    std::vector<float> image_, transmittance_;
    std::vector<std::int32_t> last_;       // per pixel: one past the last entry of its tile that it shows
};

}  // namespace mphygs
