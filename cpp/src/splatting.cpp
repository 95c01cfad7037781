#include "mphygs/splatting.hpp"

#include <algorithm>
#include <cmath>

#include "mphygs/pack.hpp"
#include "mphygs/parallel.hpp"
#include "mphygs/splatting_projection.hpp"

namespace mphygs {

namespace {

constexpr int tile = SplatPass::tile_size;
constexpr int tile_pixels = tile * tile;
constexpr int packs = tile / lane_count;
constexpr std::size_t chunk = 256;          // Gaussians projected as one piece of work
constexpr float most_alpha = 0.99f;
constexpr float least_transmittance = 1e-4f;  // a pixel that lets less through is closed
constexpr int splat_numbers = 6;            // x, y, a, b, c, opacity

using Numbers = Pack<float>;
using Mask = PackMask<float>;

bool any(Mask m) {
    std::int64_t part[lane_count / 2];
    std::memcpy(part, &m, sizeof m);
    return ((part[0] | part[1]) | (part[2] | part[3])) != 0;
}

/// e^-s for 0 <= s <= 87: 2^n e^r, |r| <= ln 2 / 2, e^r to 3e-8.
Numbers falloff(Numbers s) {
    const Numbers shifted = s * -1.44269504f + 12582912.0f;  // rounds to an integer
    const Numbers n = shifted - 12582912.0f;
    const Numbers r = (-s - n * 0.693359375f) + n * 2.12194440e-4f;
    const Numbers e =
        (((((r * (1.0f / 720) + 1.0f / 120) * r + 1.0f / 24) * r + 1.0f / 6) * r + 0.5f) * r + 1.0f) * r + 1.0f;
    Mask bits;
    std::memcpy(&bits, &e, sizeof bits);
    bits += __builtin_convertvector(n, Mask) << 23;
    Numbers value;
    std::memcpy(&value, &bits, sizeof value);
    return value;
}

/// Half the squared distance from a splat's centre in its own metric, over one pack of a row.
struct Offset {
    Numbers dx, s;
    float dy;
    Offset(const Splat& splat, Numbers x, float y) : dx(x - splat.x), dy(y - splat.y) {
        s = (dx * (0.5f * splat.a) + dy * splat.b) * dx + 0.5f * splat.c * dy * dy;
    }
    Mask inside(const Splat& splat) const { return (s <= splat.reach) & (s >= 0.0f); }
};

/// The pixels of a tile, row by row in packs.
struct TileBox {
    int column, row, columns, rows;
    Numbers x[packs];
    TileBox(const SplatCamera& camera, int tile_columns, int index)
        : column(index % tile_columns * tile),
          row(index / tile_columns * tile),
          columns(std::min(tile, camera.width - column)),
          rows(std::min(tile, camera.height - row)) {
        for (int p = 0; p < packs; ++p) {
            for (int l = 0; l < lane_count; ++l) {
                x[p][l] = static_cast<float>(column + p * lane_count + l) + 0.5f;
            }
        }
    }
    /// Calls f(pixel of the tile, pack, centre of the row) for the packs that the splat can reach.
    template <class F>
    void visit(const Splat& splat, F&& f) const {
        const int top = std::max(splat.row[0] - row, 0), bottom = std::min(splat.row[1] - row, rows);
        const int left = std::max(splat.column[0] - column, 0) / lane_count;
        const int right = (std::min(splat.column[1] - column, columns) + lane_count - 1) / lane_count;
        for (int r = top; r < bottom; ++r) {
            for (int p = left; p < right; ++p) {
                f(r * tile + p * lane_count, p, static_cast<float>(row + r) + 0.5f);
            }
        }
    }
    /// Copies between the tile's pixels and a picture of `width` columns.
    template <class F>
    void each_row(int width, F&& f) const {
        for (int r = 0; r < rows; ++r) {
            f(static_cast<std::size_t>(r) * tile, static_cast<std::size_t>(row + r) * static_cast<std::size_t>(width) + static_cast<std::size_t>(column));
        }
    }
};

/// Pixels are closed by the first splat that would leave them less than least_transmittance.
template <int fixed_channels>
void draw_tile(const TileBox& box, const Splat* splats, const float* values, int channels, const std::int32_t* rank,
               std::int32_t entries, float* sums, float* transmittance, std::int32_t* last) {
    const int count = fixed_channels ? fixed_channels : channels;
    std::fill(sums, sums + count * tile_pixels, 0.0f);
    alignas(32) std::int32_t open[tile_pixels];
    for (int k = 0; k < tile_pixels; ++k) {
        transmittance[k] = 1.0f;
        last[k] = 0;
        open[k] = k % tile < box.columns && k / tile < box.rows ? -1 : 0;
    }
    const auto load_mask = [](const std::int32_t* p) {
        Mask m;
        std::memcpy(&m, p, sizeof m);
        return m;
    };
    for (std::int32_t e = 0; e < entries; ++e) {
        if (e % 16 == 15 && std::all_of(open, open + tile_pixels, [](std::int32_t m) { return m == 0; })) {
            break;
        }
        const Splat& splat = splats[rank[e]];
        const float* value = values + static_cast<std::size_t>(rank[e]) * static_cast<std::size_t>(count);
        box.visit(splat, [&](int pixel, int p, float y) {
            const Offset at(splat, box.x[p], y);
            const Mask is_open = load_mask(open + pixel);
            const Mask seen = at.inside(splat) & is_open;
            if (!any(seen)) {
                return;
            }
            const Numbers raw = splat.opacity * falloff(select(seen, at.s, Numbers{}));
            const Numbers alpha = select(raw > most_alpha, Numbers{} + most_alpha, raw);
            const Numbers before = load<float>(transmittance + pixel);
            const Numbers after = before * (1.0f - alpha);
            const Mask closing = seen & (after < least_transmittance);
            const Mask shown = seen & ~closing;
            const Mask still_open = is_open & ~closing;
            std::memcpy(open + pixel, &still_open, sizeof still_open);
            store(transmittance + pixel, select(shown, after, before));
            Mask l = load_mask(last + pixel);
            l = shown ? Mask{} + (e + 1) : l;
            std::memcpy(last + pixel, &l, sizeof l);
            const Numbers weight = select(shown, alpha * before, Numbers{});
            for (int c = 0; c < count; ++c) {
                float* sum = sums + c * tile_pixels + pixel;
                store(sum, load<float>(sum) + weight * value[c]);
            }
        });
    }
}

/// From the last entry to the first. sums_bar (channel, pixel); behind: what lies behind, times its
/// derivative, at first transmittance times transmittance_bar. Writes splat_numbers + channels an entry.
template <int fixed_channels>
void reverse_tile(const TileBox& box, const Splat* splats, const float* values, int channels, const std::int32_t* rank,
                  std::int32_t entries, const float* sums_bar, float* transmittance, float* behind, const std::int32_t* last,
                  const std::size_t* slot, float* slot_bar, Numbers* value_bar) {
    const int count = fixed_channels ? fixed_channels : channels;
    for (std::int32_t e = entries - 1; e >= 0; --e) {
        const Splat& splat = splats[rank[e]];
        const float* value = values + static_cast<std::size_t>(rank[e]) * static_cast<std::size_t>(count);
        Numbers sx{}, sy{}, sxx{}, sxy{}, syy{}, opacity_bar{};
        std::fill(value_bar, value_bar + count, Numbers{});
        box.visit(splat, [&](int pixel, int p, float y) {
            const Offset at(splat, box.x[p], y);
            Mask l;
            std::memcpy(&l, last + pixel, sizeof l);
            const Mask shown = at.inside(splat) & (l > e);
            if (!any(shown)) {
                return;
            }
            const Numbers fall = falloff(select(shown, at.s, Numbers{}));
            const Numbers raw = splat.opacity * fall;
            const Numbers alpha = select(raw > most_alpha, Numbers{} + most_alpha, raw);
            const Numbers inverse = 1.0f / (1.0f - alpha);
            const Numbers after = load<float>(transmittance + pixel);
            const Numbers before = after * inverse;
            store(transmittance + pixel, select(shown, before, after));
            const Numbers weight = select(shown, alpha * before, Numbers{});
            Numbers colour_bar{};
            for (int c = 0; c < count; ++c) {
                const Numbers bar = load<float>(sums_bar + c * tile_pixels + pixel);
                colour_bar += value[c] * bar;
                value_bar[c] += weight * bar;
            }
            const Numbers rest = load<float>(behind + pixel);
            store(behind + pixel, rest + weight * colour_bar);
            const Numbers alpha_bar = before * colour_bar - rest * inverse;
            // no slope where alpha is cut off
            const Numbers bar = select(shown & (raw <= most_alpha), alpha_bar * fall, Numbers{});
            opacity_bar += bar;
            const Numbers bx = bar * at.dx;
            sx += bx;
            sy += bar * at.dy;
            sxx += bx * at.dx;
            sxy += bx * at.dy;
            syy += bar * (at.dy * at.dy);
        });
        // the derivative of alpha with respect to s is -opacity times its derivative with respect to opacity
        const float o = -splat.opacity, tx = sum_lanes<float>(sx), ty = sum_lanes<float>(sy);
        float* out = slot_bar + slot[e] * static_cast<std::size_t>(splat_numbers + count);
        out[0] = -o * (splat.a * tx + splat.b * ty);
        out[1] = -o * (splat.b * tx + splat.c * ty);
        out[2] = 0.5f * o * sum_lanes<float>(sxx);
        out[3] = o * sum_lanes<float>(sxy);
        out[4] = 0.5f * o * sum_lanes<float>(syy);
        out[5] = sum_lanes<float>(opacity_bar);
        for (int c = 0; c < count; ++c) {
            out[splat_numbers + c] = sum_lanes<float>(value_bar[c]);
        }
    }
}

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
            for (int c = 0; c < channels_; ++c) {
                std::copy_n(sums.data() + static_cast<std::size_t>(c * tile_pixels) + from, n,
                            image_.data() + static_cast<std::size_t>(c) * pixels + to);
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
                std::copy_n(image_bar + c * pixels + from, n, sums_bar.data() + c * tile_pixels + to);
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
