#include "mphygs/splatting/splatting.hpp"

#include <algorithm>
#include <cstring>

#include "mphygs/numerics/parallel.hpp"
#include "mphygs/splatting/projection.hpp"
#include "mphygs/splatting/tile.hpp"

namespace mphygs {

namespace {

using namespace splatting;

constexpr std::size_t chunk = 256;  // Gaussians projected as one piece of work

}  // namespace

SplatPass::SplatPass(const SplatCamera& camera, const SplatGaussians& gaussians, int threads)
    : camera_(camera),
      channels_(4 + gaussians.feature_count),
      tile_columns_((camera.width + tile - 1) / tile),
      tile_rows_((camera.height + tile - 1) / tile) {
    project(gaussians, threads);
    assign_tiles();
    const std::size_t pixels = static_cast<std::size_t>(camera.width) * static_cast<std::size_t>(camera.height);
    image_.resize(static_cast<std::size_t>(channels_) * pixels);
    transmittance_.resize(pixels);
    last_.resize(pixels);
    for_each_index(tile_columns_ * tile_rows_, threads, [&](int t) {
        const TileBox box(camera_, tile_columns_, t);
        std::vector<float> sums(static_cast<std::size_t>(channels_ * tile_pixels));
        alignas(32) float through[tile_pixels];
        alignas(32) std::int32_t last[tile_pixels];
        const std::size_t begin = tile_begin_[static_cast<std::size_t>(t)], end = tile_begin_[static_cast<std::size_t>(t) + 1];
        const auto draw = channels_ == 4 ? draw_tile<4> : draw_tile<0>;
        draw(box, splats_.data(), values_.data(), channels_, entry_rank_.data() + begin, static_cast<std::int32_t>(end - begin),
             sums.data(), through, last);
        box.each_row(camera_.width, [&](std::size_t from, std::size_t to) {
            const std::size_t n = static_cast<std::size_t>(box.columns);
            std::copy_n(through + from, n, transmittance_.data() + to);
            std::copy_n(last + from, n, last_.data() + to);
            const std::size_t channels = static_cast<std::size_t>(channels_);
            for (std::size_t c = 0; c < channels; ++c) {
                for (std::size_t k = 0; k < n; ++k) {
                    image_[c * pixels + to + k] = sums[place(from, k, c, channels)];
                }
            }
        });
    });
}

void SplatPass::project(const SplatGaussians& g, int threads) {
    std::vector<Splat> all(g.count);
    std::vector<float> values(4 * g.count);
    std::vector<char> seen(g.count);
    for_each_index(static_cast<int>((g.count + chunk - 1) / chunk), threads, [&](int part) {
        const std::size_t begin = static_cast<std::size_t>(part) * chunk, end = std::min(begin + chunk, g.count);
        for (std::size_t i = begin; i < end; ++i) {
            seen[i] = project_gaussian(camera_, g, i, all[i], values.data() + 4 * i);
        }
    });
    // depths are above zero, so that their bits are in the order of their values; equal ones by index
    std::vector<std::uint64_t> keys;
    for (std::size_t i = 0; i < g.count; ++i) {
        if (seen[i]) {
            std::uint32_t bits;
            std::memcpy(&bits, &values[4 * i + 3], sizeof bits);
            keys.push_back(static_cast<std::uint64_t>(bits) << 32 | i);
        }
    }
    std::sort(keys.begin(), keys.end());
    const std::size_t channels = static_cast<std::size_t>(channels_), features = channels - 4;
    order_.resize(keys.size());
    splats_.resize(keys.size());
    values_.resize(keys.size() * channels);
    for (std::size_t r = 0; r < keys.size(); ++r) {
        const std::size_t i = keys[r] & 0xffffffffU;
        order_[r] = static_cast<std::int32_t>(i);
        splats_[r] = all[i];
        std::copy_n(values.data() + 4 * i, 4, values_.data() + r * channels);
        std::copy_n(g.features + i * features, features, values_.data() + r * channels + 4);
    }
}

void SplatPass::assign_tiles() {
    const auto each_tile = [&](const Splat& s, auto&& f) {
        for (int row = s.row[0] / tile; row <= (s.row[1] - 1) / tile; ++row) {
            for (int column = s.column[0] / tile; column <= (s.column[1] - 1) / tile; ++column) {
                f(static_cast<std::size_t>(row * tile_columns_ + column));
            }
        }
    };
    tile_begin_.assign(static_cast<std::size_t>(tile_columns_ * tile_rows_) + 1, 0);
    slot_begin_.assign(splats_.size() + 1, 0);
    for (std::size_t r = 0; r < splats_.size(); ++r) {
        std::size_t count = 0;
        each_tile(splats_[r], [&](std::size_t t) {
            ++tile_begin_[t + 1];
            ++count;
        });
        slot_begin_[r + 1] = slot_begin_[r] + count;
    }
    for (std::size_t t = 1; t < tile_begin_.size(); ++t) {
        tile_begin_[t] += tile_begin_[t - 1];
    }
    entry_rank_.resize(slot_begin_.back());
    entry_slot_.resize(slot_begin_.back());
    std::vector<std::size_t> next(tile_begin_.begin(), tile_begin_.end() - 1);
    for (std::size_t r = 0; r < splats_.size(); ++r) {
        std::size_t slot = slot_begin_[r];
        each_tile(splats_[r], [&](std::size_t t) {
            entry_rank_[next[t]] = static_cast<std::int32_t>(r);
            entry_slot_[next[t]++] = slot++;
        });
    }
}

SplatGradient SplatPass::backward(const SplatGaussians& g, const float* image_bar, const float* transmittance_bar, int threads) const {
    const std::size_t pixels = transmittance_.size(), channels = static_cast<std::size_t>(channels_);
    const std::size_t width = splat_numbers + channels;
    std::vector<float> slot_bar(slot_begin_.back() * width);
    for_each_index(tile_columns_ * tile_rows_, threads, [&](int t) {
        const TileBox box(camera_, tile_columns_, t);
        std::vector<float> sums_bar(channels * tile_pixels);
        std::vector<Numbers> value_bar(channels);
        alignas(32) float through[tile_pixels]{}, behind[tile_pixels]{};
        alignas(32) std::int32_t last[tile_pixels]{};
        box.each_row(camera_.width, [&](std::size_t to, std::size_t from) {
            const std::size_t n = static_cast<std::size_t>(box.columns);
            std::copy_n(transmittance_.data() + from, n, through + to);
            std::copy_n(last_.data() + from, n, last + to);
            for (std::size_t k = 0; k < n; ++k) {
                behind[to + k] = transmittance_[from + k] * transmittance_bar[from + k];
            }
            for (std::size_t c = 0; c < channels; ++c) {
                for (std::size_t k = 0; k < n; ++k) {
                    sums_bar[place(to, k, c, channels)] = image_bar[c * pixels + from + k];
                }
            }
        });
        const std::size_t begin = tile_begin_[static_cast<std::size_t>(t)];
        // entries beyond the last that any pixel shows have no derivative: their slots stay zero
        const std::int32_t shown = *std::max_element(last, last + tile_pixels);
        const auto reverse = channels_ == 4 ? reverse_tile<4> : reverse_tile<0>;
        reverse(box, splats_.data(), values_.data(), channels_, entry_rank_.data() + begin, shown, sums_bar.data(), through, behind,
                last, entry_slot_.data() + begin, slot_bar.data(), value_bar.data());
    });
    const std::size_t harmonics = 3 * static_cast<std::size_t>(g.harmonic_count), features = channels - 4;
    SplatGradient out;
    out.positions.resize(3 * g.count);
    out.rotations.resize(4 * g.count);
    out.scales.resize(3 * g.count);
    out.opacities.resize(g.count);
    out.harmonics.resize(harmonics * g.count);
    out.features.resize(features * g.count);
    out.screen_offsets.resize(2 * g.count);
    for_each_index(static_cast<int>((order_.size() + chunk - 1) / chunk), threads, [&](int part) {
        const std::size_t begin = static_cast<std::size_t>(part) * chunk, end = std::min(begin + chunk, order_.size());
        std::vector<double> sum(width);
        for (std::size_t r = begin; r < end; ++r) {
            std::fill(sum.begin(), sum.end(), 0.0);
            for (std::size_t slot = slot_begin_[r]; slot < slot_begin_[r + 1]; ++slot) {
                for (std::size_t k = 0; k < width; ++k) {
                    sum[k] += slot_bar[slot * width + k];
                }
            }
            SplatBar bar{sum[0], sum[1], sum[2], sum[3], sum[4], sum[5], {sum[6], sum[7], sum[8], sum[9]}};
            const std::size_t i = static_cast<std::size_t>(order_[r]);
            project_gaussian_reverse(camera_, g, i, bar, out);
            for (std::size_t c = 0; c < features; ++c) {
                out.features[i * features + c] = static_cast<float>(sum[splat_numbers + 4 + c]);
            }
        }
    });
    return out;
}

}  // namespace mphygs
