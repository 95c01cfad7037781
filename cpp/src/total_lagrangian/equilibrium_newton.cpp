// The rest shape by Newton's method, from stiff to soft where it does not get there at once.
#include <algorithm>
#include <cmath>

#include "mphygs/total_lagrangian/equilibrium_assembly.hpp"

namespace mphygs {

namespace {

// Of a Newton step over the one before: a step this much shorter shows that the next one may do with the same
// matrix, and with that one, that another one may.
constexpr double enough_to_keep = 0.1, enough_to_go_on = 0.3;

// Of the material whose stiffness holds the shapes of a cell that its eight points cannot see [Pa]. What these springs
// carry nothing carries in motion, so they are as soft as Newton's method can do with: where it does not get there
// at once, it goes from stiff to soft.
constexpr double softest = 1e-5, stiff_to_soft[] = {0.05, 1e-3, 1e-4, softest};
constexpr int iterations_at_once = 12;

using P = Pack<double>;

}  // namespace

Equilibrium::Solution Equilibrium::solve(const Fields<double>& fields, const std::vector<double>& volume,
                                         const std::vector<double>& load, const std::vector<double>& start, double tolerance,
                                         int iterations) {
    const std::size_t nodes = 3 * model_->node_count();
    const std::size_t points = 8 * model_->geometry().block_count();
    if (volume.size() != points || fields.mu.size() != points || fields.lambda.size() != points || load.size() != nodes ||
        (!start.empty() && start.size() != nodes) || fields.effect.size() != static_cast<std::size_t>(Registry::parameter_count)) {
        throw std::invalid_argument("equilibrium: mu, lambda and volume are (blocks, 8), load and start (nodes, 3)");
    }
    fields_ = fields;
    volume_ = volume;
    load_ = load;
    const auto begin = [&] {
        w_ = start.empty() ? std::vector<double>(nodes, 0.0) : start;
        if (start.empty()) {
            unknown_.setZero();  // the hold's forces too: what was solved before must not show
        }
    };
    begin();
    Solution s;
    unseen_ = softest;
    try {
        if (newton(tolerance, std::min(iterations, iterations_at_once), s)) {
            return s;
        }
    } catch (const SimulationError&) {  // a singular matrix far from the solution
    }
    begin();
    unknown_.setZero();
    Solution found;
    std::vector<double> map;
    Eigen::VectorXd unknown;
    double stiffness = 0;
    for (const double next : stiff_to_soft) {
        unseen_ = next;
        try {
            if (!newton(tolerance, iterations, s)) {
                break;
            }
        } catch (const SimulationError&) {
            if (map.empty()) {
                throw;  // singular with the stiffest springs: the object hangs on nothing
            }
            break;
        }
        found = s;
        map = w_;
        unknown = unknown_;
        stiffness = next;
    }
    if (map.empty()) {
        throw SimulationError("equilibrium: Newton's method did not converge in " + std::to_string(iterations) +
                              " steps (last step " + std::to_string(s.last_step) +
                              " m); the object is too soft to carry its weight in the published shape");
    }
    if (stiffness != unseen_) {
        w_ = map;
        unknown_ = unknown;
        unseen_ = stiffness;
        factors_are_here_ = false;
    }
    return found;
}

bool Equilibrium::newton(double tolerance, int iterations, Solution& s) {
    const std::size_t nodes = 3 * model_->node_count();
    Eigen::VectorXd residual;
    bool fresh = true;  // a new matrix, for the factors cost most of the time
    double before = INFINITY;
    for (s.iterations = 1; s.iterations <= iterations; ++s.iterations) {
        assemble(w_, fresh, residual);
        if (fresh) {
            factorise();
        }
        const Eigen::VectorXd step = solver_.solve(-residual);
        // A full step may invert a point of a very soft part: halve it until no point is inverted.
        double length = 1.0;
        const Assembly a{*model_};
        for (int half = 0; half < 12; ++half, length *= 0.5) {
            std::vector<double> trial = w_;
            for (std::size_t i = 0; i < nodes; ++i) {
                trial[i] += length * step[static_cast<Eigen::Index>(i)];
            }
            bool good = true;
            for (std::size_t b = 0; b < a.blocks() && good; ++b) {
                const Mat3<P> h = Mat3<P>::identity() + a.gradient(b, trial);
                const P j = determinant(h, cofactor(h));
                for (int q = 0; q < lane_count; ++q) {
                    good &= j[q] > 0.05;
                }
            }
            if (good) {
                w_ = trial;
                break;
            }
        }
        unknown_ += length * step;
        for (std::size_t i = 0; i < nodes; ++i) {
            unknown_[static_cast<Eigen::Index>(i)] = w_[i];
        }
        // Nodes that carry next to no material move without meaning: the material's step counts.
        s.last_step = 0;
        const std::vector<double> moved(step.data(), step.data() + nodes);
        for (std::size_t b = 0; b < a.blocks(); ++b) {
            const Vec3<P> at = a.value(b, moved);
            const P square = dot(at, at);
            for (int q = 0; q < lane_count; ++q) {
                s.last_step = std::max(s.last_step, std::isfinite(square[q]) ? std::sqrt(square[q]) : INFINITY);
            }
        }
        if (!std::isfinite(s.last_step)) {
            break;
        }
        if (length == 1.0 && s.last_step < tolerance) {
            factors_are_here_ = fresh;
            fill(s);
            return true;
        }
        // The last matrix serves as long as the steps shrink fast with it.
        const double shrunk = std::isfinite(before) ? s.last_step / before : 1.0;
        fresh = length < 1.0 || shrunk > (fresh ? enough_to_keep : enough_to_go_on);
        before = s.last_step;
    }
    return false;
}

}  // namespace mphygs
