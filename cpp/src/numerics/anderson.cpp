#include "mphygs/numerics/anderson.hpp"

#include <cmath>

namespace mphygs {

namespace {

// Of a change of d over what earlier ones leave of it: less is round-off.
constexpr double something_new = 1e-6;

}  // namespace

void Anderson::forget() {
    dx_.clear();
    dd_.clear();
    x_.resize(0);
}

Eigen::VectorXd Anderson::next(const Eigen::VectorXd& x, const Eigen::VectorXd& d) {
    if (x_.size() > 0) {
        Eigen::VectorXd dx = x - x_, dd = d - d_;
        const double whole = std::sqrt(product(dd, dd));
        for (std::size_t k = 0; k < dd_.size(); ++k) {
            const double along = product(dd_[k], dd);
            dd -= along * dd_[k];
            dx -= along * dx_[k];
        }
        const double size = std::sqrt(product(dd, dd));
        if (size > something_new * whole) {
            if (dd_.size() == memory_) {
                dx_.erase(dx_.begin());
                dd_.erase(dd_.begin());
            }
            dx_.push_back(dx / size);
            dd_.push_back(dd / size);
        }
    }
    x_ = x;
    d_ = d;
    Eigen::VectorXd result = x + d, rest = d;
    for (std::size_t k = 0; k < dd_.size(); ++k) {
        const double along = product(dd_[k], rest);
        rest -= along * dd_[k];
        result -= along * (dx_[k] + dd_[k]);
    }
    return result;
}

}  // namespace mphygs
