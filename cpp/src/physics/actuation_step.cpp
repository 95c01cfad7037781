// Loads in one substep: from what carriers do to points, and from forces at points to carriers.
#include <algorithm>

#include "mphygs/physics/actuation.hpp"

namespace mphygs {

template <class T>
void ActuationStep::channels_of(const std::vector<T>* field, std::size_t interval, const double (&powers)[4]) {
    channels.assign(loads_.channels(), 0.0);
    for (std::size_t i = 0; field && !field->empty() && i < channels.size(); ++i) {
        for (std::size_t k = 0; k < 4; ++k) {
            channels[i] += powers[k] * static_cast<double>((*field)[(interval * channels.size() + i) * 4 + k]);
        }
    }
}
template void ActuationStep::channels_of(const std::vector<float>*, std::size_t, const double (&)[4]);
template void ActuationStep::channels_of(const std::vector<double>*, std::size_t, const double (&)[4]);

void ActuationStep::add_channels_bar(std::size_t interval, const double (&powers)[4], std::vector<double>& field_bar) const {
    for (std::size_t i = 0; i < channels.size(); ++i) {
        for (std::size_t k = 0; k < 4; ++k) {
            field_bar[(interval * channels.size() + i) * 4 + k] += powers[k] * channels[i];
        }
    }
}

void ActuationStep::gather() {
    points_.assign(3 * loads_.point_count(), 0.0);
    for (std::size_t p = 0; p < loads_.point_count(); ++p) {
        for (auto r = static_cast<std::size_t>(loads_.row_begin[p]); r < static_cast<std::size_t>(loads_.row_begin[p + 1]); ++r) {
            for (std::size_t c = 0; loads_.read_at_[r] >= 0 && c < 3; ++c) {
                points_[3 * p + c] += loads_.row_weight[r] * seen[3 * static_cast<std::size_t>(loads_.read_at_[r]) + c];
            }
        }
    }
}

void ActuationStep::scatter(const std::vector<double>& at_points) {
    std::fill(pushed.begin(), pushed.end(), 0.0);
    for (std::size_t p = 0; p < loads_.point_count(); ++p) {
        for (auto r = static_cast<std::size_t>(loads_.row_begin[p]); r < static_cast<std::size_t>(loads_.row_begin[p + 1]); ++r) {
            for (std::size_t c = 0; loads_.pushed_at_[r] >= 0 && c < 3; ++c) {
                pushed[3 * static_cast<std::size_t>(loads_.pushed_at_[r]) + c] += loads_.row_weight[r] * at_points[3 * p + c];
            }
        }
    }
}

/// From displacements to places, or the change of places: X + u, X where nothing carries a point, R X + p on a hold.
void ActuationStep::carry(bool change) {
    for (std::size_t p = 0; p < loads_.point_count(); ++p) {
        const double* rest = &loads_.place[3 * p];
        for (std::size_t c = 0; c < 3; ++c) {
            double& x = points_[3 * p + c];
            if (loads_.hold[p] >= 0 && !poses.empty()) {
                const double* pose = &poses[12 * static_cast<std::size_t>(loads_.hold[p])];
                x = pose[9 + c] + pose[3 * c] * rest[0] + pose[3 * c + 1] * rest[1] + pose[3 * c + 2] * rest[2];
            } else if (!change) {
                x += rest[c];
            }
        }
    }
}

void ActuationStep::value() {
    gather();
    carry(false);
    x_ = points_;
    c_ = channels;
    loads_.forces(x_, c_, force_);
    scatter(force_);
}

void ActuationStep::change() {
    gather();
    carry(true);
    loads_.forces_change(x_, c_, points_, channels, force_);
    scatter(force_);
}

void ActuationStep::reverse() {
    force_.assign(3 * loads_.point_count(), 0.0);
    std::fill(seen.begin(), seen.end(), 0.0);
    for (const bool back : {true, false}) {
        for (std::size_t p = 0; p < loads_.point_count(); ++p) {
            for (auto r = static_cast<std::size_t>(loads_.row_begin[p]); r < static_cast<std::size_t>(loads_.row_begin[p + 1]); ++r) {
                const std::int32_t at = back ? loads_.pushed_at_[r] : loads_.read_at_[r];
                for (std::size_t c = 0; at >= 0 && c < 3; ++c) {
                    const std::size_t i = 3 * static_cast<std::size_t>(at) + c;
                    if (back) {
                        force_[3 * p + c] += loads_.row_weight[r] * pushed[i];
                    } else {
                        seen[i] += loads_.row_weight[r] * points_[3 * p + c];
                    }
                }
            }
        }
        if (back) {
            loads_.forces_bar(x_, c_, force_, points_, channels);
        }
    }
    std::fill(poses.begin(), poses.end(), 0.0);
    for (std::size_t p = 0; p < loads_.point_count(); ++p) {
        for (std::size_t c = 0; loads_.hold[p] >= 0 && !poses.empty() && c < 3; ++c) {
            double* pose = &poses[12 * static_cast<std::size_t>(loads_.hold[p])];
            pose[9 + c] += points_[3 * p + c];
            for (std::size_t k = 0; k < 3; ++k) {
                pose[3 * c + k] += points_[3 * p + c] * loads_.place[3 * p + k];
            }
        }
    }
}

}  // namespace mphygs
