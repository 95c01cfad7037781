// Runs that cannot be: what they say.
#include <gtest/gtest.h>

#include <string>

#include "bar_scene.hpp"

namespace mphygs {
namespace {

using test::Bar;
using test::BarOptions;

TEST(Failure, AnUnstableRunNamesTheFrameAndThePart) {
    BarOptions o;
    o.young[1] = 1e10;  // the upper part; the other is stable at this step
    Settings settings;
    settings.displacement_limit = 1.0;
    Bar bar = test::make_bar(o, {std::vector<int>(200, 1), std::vector<double>(200, 1e-4)}, settings);
    bar.fields.velocity0.assign(3 * bar.model->node_count(), 0.0);
    bar.fields.velocity0[3 * bar.model->node_count() - 1] = 0.1;  // a push at the far end
    int frame = -1;
    try {
        bar.model->simulate(bar.fields, bar.schedule);
        FAIL() << "an unstable run must throw";
    } catch (const SimulationError& error) {
        frame = error.frame;
        EXPECT_GT(frame, 0);
        EXPECT_LT(frame, 200);
        EXPECT_EQ(error.part, 1);
        EXPECT_NE(std::string(error.what()).find("frame " + std::to_string(frame)), std::string::npos) << error.what();
        EXPECT_NE(std::string(error.what()).find("part 1"), std::string::npos) << error.what();
    }
    Trajectory<double> bar_of;
    bar_of.displacement.assign(201 * 3 * bar.model->node_count(), 0.0);
    try {
        bar.model->adjoint(bar.fields, bar.schedule, bar_of);
        FAIL() << "the gradient of an unstable run must throw";
    } catch (const SimulationError& error) {
        EXPECT_EQ(error.frame, frame);
        EXPECT_EQ(error.part, 1);
    }
}

TEST(Failure, ProgressIsToldEveryFrameAndMayStop) {
    const Bar bar = test::make_bar({}, {{2, 2, 2}, {1e-4, 1e-4, 1e-4}});
    std::vector<int> frames;
    bar.model->simulate(bar.fields, bar.schedule, [&](int f) {
        frames.push_back(f);
        return true;
    });
    EXPECT_EQ(frames, (std::vector<int>{1, 2, 3}));
    EXPECT_THROW(bar.model->simulate(bar.fields, bar.schedule, [](int f) { return f < 2; }), SimulationError);
}

TEST(Failure, AWrongSizeIsNamed) {
    const Bar bar = test::make_bar({}, {{2}, {1e-4}});
    const auto message = [&](auto&& change) {
        Fields<double> f = bar.fields;
        Schedule s = bar.schedule;
        change(f, s);
        try {
            bar.model->simulate(f, s);
        } catch (const std::invalid_argument& error) {
            return std::string(error.what());
        }
        return std::string("nothing was thrown");
    };
    EXPECT_NE(message([](auto& f, auto&) { f.mu.pop_back(); }).find("mu has 159 numbers, expected 160"), std::string::npos);
    EXPECT_NE(message([](auto& f, auto&) { f.gravity.clear(); }).find("gravity"), std::string::npos);
    EXPECT_NE(message([](auto& f, auto&) { f.pose.pop_back(); }).find("pose"), std::string::npos);
    EXPECT_NE(message([](auto& f, auto&) { f.velocity0.assign(5, 0.0); }).find("velocity0"), std::string::npos);
    EXPECT_NE(message([](auto&, auto& s) { s.dt[0] = 0; }).find("dt"), std::string::npos);
    EXPECT_THROW(TotalLagrangian<double>(Geometry{}, Settings{}), std::invalid_argument);
}

}  // namespace
}  // namespace mphygs
