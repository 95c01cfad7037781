// One tile of a picture: Gaussians composited front to back, and the adjoint, a pack of a row at a time.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <cstring>

#include "mphygs/numerics/pack.hpp"
#include "mphygs/splatting/splatting.hpp"

namespace mphygs::splatting {

inline constexpr int tile = SplatPass::tile_size;
inline constexpr int tile_pixels = tile * tile;
inline constexpr int packs = tile / lane_count;
inline constexpr float most_alpha = 0.99f;
inline constexpr float least_transmittance = 1e-4f;  // a pixel that lets less through is closed
inline constexpr int splat_numbers = 6;              // x, y, a, b, c, opacity

using Numbers = Pack<float>;
using Mask = PackMask<float>;

inline bool any(Mask m) {
    std::int64_t part[lane_count / 2];
    std::memcpy(part, &m, sizeof m);
    return ((part[0] | part[1]) | (part[2] | part[3])) != 0;
}

/// e^-s for 0 <= s <= 87: 2^n e^r, |r| <= ln 2 / 2, e^r to 3e-8.
inline Numbers falloff(Numbers s) {
    const Numbers shifted = s * -1.44269504f + 12582912.0f;  // rounds to an integer
    const Numbers n = shifted - 12582912.0f;
    const Numbers r = (-s - n * 0.693359375f) + n * 2.12194440e-4f;
    const Numbers e =
        (((((r * (1.0f / 720) + 1.0f / 120) * r + 1.0f / 24) * r + 1.0f / 6) * r + 0.5f) * r + 1.0f) * r + 1.0f;
    const Mask bits = read<Mask>(&e) + (convert<Mask>(n) << 23);
    return read<Numbers>(&bits);
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
            const std::size_t pixel = static_cast<std::size_t>(row + r) * static_cast<std::size_t>(width);
            f(static_cast<std::size_t>(r) * tile, pixel + static_cast<std::size_t>(column));
        }
    }
};

/// Where pixel k of a row that begins at pixel `row` of its tile keeps channel c. The channels of a pack lie
/// together: a stride of a whole tile between them would put them all into the same few lines of the cache.
inline std::size_t place(std::size_t row, std::size_t k, std::size_t c, std::size_t channels) {
    return (row + k / lane_count * lane_count) * channels + c * lane_count + k % lane_count;
}

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
            l = choose(shown, Mask{} + (e + 1), l);
            std::memcpy(last + pixel, &l, sizeof l);
            const Numbers weight = select(shown, alpha * before, Numbers{});
            for (int c = 0; c < count; ++c) {
                float* sum = sums + pixel * count + c * lane_count;
                store(sum, load<float>(sum) + weight * value[c]);
            }
        });
    }
}

/// From the last entry to the first. sums_bar: see place(); behind: what lies behind, times its
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
                const Numbers bar = load<float>(sums_bar + pixel * count + c * lane_count);
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

}  // namespace mphygs::splatting
