// An observer as the substeps of a run take it: its sparse rows, laid out for registers.
//
// Channels read the few carriers that they name, three components at a time. Carriers are pulled eight at a time: every
// pack of eight has the channels that reach any of them, with eight weights for each number of G. The same rows
// backwards are the transpose.
#pragma once

#include <algorithm>
#include <array>
#include <vector>

#include "mphygs/numerics/pack.hpp"
#include "mphygs/numerics/team.hpp"
#include "mphygs/physics/observer.hpp"

namespace mphygs {

template <class T>
class ObserverRows {
  public:
    /// x, y, z, and one that stays 0.
    using Quad = Vector<T, 4>;
    static constexpr std::size_t quad = 4;

    /// stride: what is pulled, padded to whole packs; row(n): row of G of the n-th, -1 where it is not.
    template <class F>
    ObserverRows(const Observer& observer, std::size_t stride, const F& row) : observer_(observer), stride_(stride), size_(observer.reach_size()) {
        const auto last = std::max_element(observer.row_carrier.begin(), observer.row_carrier.end());
        std::vector<std::int32_t> place(last == observer.row_carrier.end() ? 0 : static_cast<std::size_t>(*last) + 1, -1);
        for (const std::int32_t n : observer.row_carrier) {
            std::int32_t& at = place[static_cast<std::size_t>(n)];
            if (at < 0) {
                at = static_cast<std::int32_t>(read_.size());
                read_.push_back(static_cast<std::size_t>(n));
            }
            row_at_.push_back(static_cast<std::size_t>(at));
        }
        row_weight_.assign(observer.row_weight.begin(), observer.row_weight.end());
        pack_pulls(row);
    }

    std::size_t channels() const { return observer_.channel_count(); }
    /// The carriers that channels read, each once.
    const std::vector<std::size_t>& read_carriers() const { return read_; }

    /// f(which of them, weight) for what a channel reads.
    template <class F>
    void each_row(std::size_t channel, const F& f) const {
        const auto end = static_cast<std::size_t>(observer_.row_begin[channel + 1]);
        for (auto r = static_cast<std::size_t>(observer_.row_begin[channel]); r < end; ++r) {
            f(row_at_[r], row_weight_[r]);
        }
    }

    /// Whether any channel pulls in an output interval.
    bool pulls(std::size_t interval) const {
        const auto begin = observer_.share.begin() + static_cast<std::ptrdiff_t>(interval * channels());
        return std::any_of(begin, begin + static_cast<std::ptrdiff_t>(channels()), [](double s) { return s != 0.0; });
    }

    /// to: (channels, 4 powers, quad) of a field's target in an interval, times the shares; zero where there is none.
    void aim(std::size_t interval, const std::vector<T>& target, std::vector<T>& to) const {
        to.assign(channels() * 4 * quad, T{});
        for (std::size_t i = 0; i < channels() && !target.empty(); ++i) {
            const T share = share_of(interval, i);
            for (std::size_t k = 0; k < 12; ++k) {
                to[(i * 4 + k / 3) * quad + k % 3] = share * target[(interval * channels() + i) * 12 + k];
            }
        }
    }

    /// What each power of a target counts at a substep.
    std::array<T, 4> factors(const TargetBasis& basis) const {
        std::array<T, 4> f{};
        for (std::size_t k = 0; k < 4; ++k) {
            f[k] = stiffness() * static_cast<T>(basis.value[k]) + damping() * static_cast<T>(basis.rate[k]);
        }
        return f;
    }
    T stiffness() const { return static_cast<T>(observer_.stiffness); }
    T damping() const { return static_cast<T>(observer_.damping); }

    /// asked: (channels, quad) share (stiffness e + damping de/dt) [m/s^2], for aims as `aim` gives them.
    /// blend: (read carriers, quad) stiffness u + damping v: rows are linear, one pass does for place and rate.
    void ask(std::size_t interval, const std::array<T, 4>& factors, const std::vector<T>& aims, const std::vector<T>& blend,
             std::vector<T>& asked) const {
        asked.resize(channels() * quad);
        for (std::size_t i = 0; i < channels(); ++i) {
            const T share = share_of(interval, i);
            Quad wanted{}, seen{};
            if (share != T{}) {
                for (std::size_t k = 0; k < 4; ++k) {
                    wanted += factors[k] * read<Quad>(&aims[(4 * i + k) * quad]);
                }
                each_row(i, [&](std::size_t at, T weight) { seen += weight * read<Quad>(&blend[at * quad]); });
            }
            write(&asked[i * quad], wanted - share * seen);
        }
    }

    /// The transpose: asked_bar to target_bar, (intervals, channels, 4, 3), and to blend_bar, which starts at 0.
    void ask_bar(std::size_t interval, const TargetBasis& basis, const std::vector<T>& asked_bar, std::vector<double>& target_bar,
                 std::vector<T>& blend_bar) const {
        blend_bar.assign(read_.size() * quad, T{});
        for (std::size_t i = 0; i < channels(); ++i) {
            const T share = share_of(interval, i);
            if (share == T{}) {
                continue;
            }
            const Quad bar = share * read<Quad>(&asked_bar[i * quad]);
            for (std::size_t k = 0; k < 4; ++k) {
                const double factor = observer_.stiffness * basis.value[k] + observer_.damping * basis.rate[k];
                for (std::size_t c = 0; c < 3; ++c) {
                    target_bar[((interval * channels() + i) * 4 + k) * 3 + c] += factor * static_cast<double>(bar[c]);
                }
            }
            each_row(i, [&](std::size_t at, T weight) {
                T* to = &blend_bar[at * quad];
                write(to, read<Quad>(to) - weight * bar);
            });
        }
    }

    /// h G asked, for as many columns as there are: every number of G is read once for all. asked: as `ask` gives them;
    /// pulled: (3, stride) of each.
    void pull(Team& team, T h, const std::vector<const T*>& asked, const std::vector<T*>& pulled) const {
        const int packs = static_cast<int>(pack_begin_.size()) - 1;
        team.each((packs + share - 1) / share, [&](int part) {
            for (int b = part * share; b < std::min(packs, (part + 1) * share); ++b) {
                size_ == 1 ? pull_pack<1>(static_cast<std::size_t>(b), h, asked, pulled)
                           : pull_pack<9>(static_cast<std::size_t>(b), h, asked, pulled);
            }
        });
    }

    /// The transpose: asked_bar = h G^T of v_bar.
    void pull_bar(T h, const T* v_bar, std::vector<T>& asked_bar) const {
        size_ == 1 ? pull_bar_by<1>(h, v_bar, asked_bar) : pull_bar_by<9>(h, v_bar, asked_bar);
    }

  private:
    using P = Pack<T>;
    static constexpr std::size_t lanes = lane_count;
    static constexpr std::size_t abreast = 5;  // columns whose sums registers hold
    static constexpr int share = 16;           // packs that a thread takes at a time

    T share_of(std::size_t interval, std::size_t channel) const {
        return static_cast<T>(observer_.share[interval * channels() + channel]);
    }
    template <class F>
    void pack_pulls(const F& row) {
        const Observer& o = observer_;
        std::vector<std::int32_t> slot(channels(), -1);
        pack_begin_ = {0};
        for (std::size_t first = 0; first < stride_; first += lanes) {
            for (std::size_t n = first; n < first + lanes; ++n) {
                const std::int32_t own = row(n);
                const std::size_t end = own < 0 ? 0 : static_cast<std::size_t>(o.reach_begin[static_cast<std::size_t>(own) + 1]);
                for (std::size_t r = own < 0 ? 0 : static_cast<std::size_t>(o.reach_begin[static_cast<std::size_t>(own)]); r < end; ++r) {
                    std::int32_t& at = slot[static_cast<std::size_t>(o.reach_channel[r])];
                    if (at < 0) {
                        at = static_cast<std::int32_t>(pack_channel_.size());
                        pack_channel_.push_back(static_cast<std::size_t>(o.reach_channel[r]));
                        pack_weight_.resize(pack_channel_.size() * size_ * lanes);
                    }
                    for (std::size_t k = 0; k < size_; ++k) {
                        pack_weight_[(static_cast<std::size_t>(at) * size_ + k) * lanes + n - first] += static_cast<T>(o.reach_weight[r * size_ + k]);
                    }
                }
            }
            for (std::size_t r = pack_begin_.back(); r < pack_channel_.size(); ++r) {
                slot[pack_channel_[r]] = -1;
            }
            pack_begin_.push_back(pack_channel_.size());
        }
    }

    template <std::size_t Size>
    void pull_pack(std::size_t b, T h, const std::vector<const T*>& asked, const std::vector<T*>& pulled) const {
        for (std::size_t k = 0; k < asked.size(); k += abreast) {
            const T* const* from = &asked[k];
            T* const* to = &pulled[k];
            switch (std::min(abreast, asked.size() - k)) {
                case 1: pull_columns<Size, 1>(b, h, from, to); break;
                case 2: pull_columns<Size, 2>(b, h, from, to); break;
                case 3: pull_columns<Size, 3>(b, h, from, to); break;
                case 4: pull_columns<Size, 4>(b, h, from, to); break;
                default: pull_columns<Size, abreast>(b, h, from, to);
            }
        }
    }
    /// A column's sums are the same to the bit whatever stands beside it: of the first half of the channels, and of the
    /// second. One column alone has both at once, for its chains would be long.
    template <std::size_t Size, std::size_t Columns>
    void pull_columns(std::size_t b, T h, const T* const* asked, T* const* pulled) const {
        const std::size_t begin = pack_begin_[b], half = (pack_begin_[b + 1] - begin) / 2, middle = begin + half;
        P first[Columns][3] = {}, second[Columns][3] = {};
        if constexpr (Columns == 1) {
            for (std::size_t r = 0; r < half; ++r) {
                add_channel<Size, Columns>(begin + r, asked, first);
                add_channel<Size, Columns>(middle + r, asked, second);
            }
        } else {
            for (std::size_t r = begin; r < middle; ++r) {
                add_channel<Size, Columns>(r, asked, first);
            }
            for (std::size_t r = middle; r < middle + half; ++r) {
                add_channel<Size, Columns>(r, asked, second);
            }
        }
        if (middle + half < pack_begin_[b + 1]) {
            add_channel<Size, Columns>(middle + half, asked, second);
        }
        for (std::size_t j = 0; j < Columns; ++j) {
            for (std::size_t c = 0; c < 3; ++c) {
                store<T>(pulled[j] + c * stride_ + b * lanes, h * (first[j][c] + second[j][c]));
            }
        }
    }
    template <std::size_t Size, std::size_t Columns>
    [[gnu::always_inline]] void add_channel(std::size_t r, const T* const* asked, P (&sum)[Columns][3]) const {
        const std::size_t from = pack_channel_[r] * quad;
        const T* weights = &pack_weight_[r * Size * lanes];
        for (std::size_t c = 0; c < 3; ++c) {
            for (std::size_t k = 0; k < (Size == 1 ? 1 : 3); ++k) {
                const P weight = load<T>(weights + (Size == 1 ? 0 : 3 * c + k) * lanes);
                for (std::size_t j = 0; j < Columns; ++j) {
                    sum[j][c] += weight * asked[j][from + (Size == 1 ? c : k)];
                }
            }
        }
    }

    template <std::size_t Size>
    void pull_bar_by(T h, const T* v_bar, std::vector<T>& asked_bar) const {
        std::vector<T> sums(3 * lanes * channels());  // of a register each
        for (std::size_t b = 0; b + 1 < pack_begin_.size(); ++b) {
            P bar[3];
            for (std::size_t c = 0; c < 3; ++c) {
                bar[c] = load<T>(v_bar + c * stride_ + b * lanes);
            }
            for (std::size_t r = pack_begin_[b]; r < pack_begin_[b + 1]; ++r) {
                T* to = &sums[pack_channel_[r] * 3 * lanes];
                const T* weight = &pack_weight_[r * Size * lanes];
                for (std::size_t k = 0; k < 3; ++k) {
                    P sum = load<T>(to + k * lanes);
                    if constexpr (Size == 1) {
                        sum += load<T>(weight) * bar[k];
                    } else {
                        for (std::size_t c = 0; c < 3; ++c) {
                            sum += load<T>(weight + (3 * c + k) * lanes) * bar[c];
                        }
                    }
                    store<T>(to + k * lanes, sum);
                }
            }
        }
        asked_bar.assign(channels() * quad, T{});
        for (std::size_t i = 0; i < 3 * channels(); ++i) {
            asked_bar[i / 3 * quad + i % 3] = h * sum_lanes<T>(load<T>(&sums[i * lanes]));
        }
    }

    const Observer& observer_;
    std::size_t stride_, size_;                        // numbers to each G: 1 or 9
    std::vector<std::size_t> read_, row_at_;           // carriers that are read; of each weight, which of them
    std::vector<T> row_weight_;
    std::vector<std::size_t> pack_begin_, pack_channel_;  // channels of each pack of carriers
    std::vector<T> pack_weight_;                          // (channels of all packs, numbers to each G, 8)
};

// Compiled once, in src/physics/observer_rows.cpp.
#define MPHYGS_OBSERVER_ROWS(keyword, T)                                                                                    \
    keyword template void ObserverRows<T>::pull(Team&, T, const std::vector<const T*>&, const std::vector<T*>&) const;     \
    keyword template void ObserverRows<T>::pull_bar(T, const T*, std::vector<T>&) const;
MPHYGS_OBSERVER_ROWS(extern, float)
MPHYGS_OBSERVER_ROWS(extern, double)

}  // namespace mphygs
