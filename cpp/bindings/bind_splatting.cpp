#include "mphygs/splatting/similarity.hpp"
#include "mphygs/splatting/splatting.hpp"

#include <limits>
#include <memory>
#include <optional>
#include <stdexcept>

#include "arrays.hpp"

namespace mphygs_python {

namespace {

using namespace mphygs;
using Floats = Array<float>;

/// A picture with the arrays it was made from, which its gradient reads again.
struct Picture {
    Floats positions, rotations, scales, opacities, harmonics, features;
    std::optional<Floats> screen_offsets;
    SplatGaussians gaussians;
    std::unique_ptr<SplatPass> pass;
};

void check(const Floats& a, const char* name, std::vector<py::ssize_t> shape) {
    if (std::vector<py::ssize_t>(a.shape(), a.shape() + a.ndim()) != shape) {
        throw std::invalid_argument(std::string(name) + " has another shape than expected");
    }
}

std::unique_ptr<Picture> make_picture(const SplatCamera& camera, Floats positions, Floats rotations, Floats scales, Floats opacities,
                                      Floats harmonics, Floats features, std::optional<Floats> screen_offsets, int threads) {
    if (opacities.ndim() != 1 || harmonics.ndim() != 3 || features.ndim() != 2) {
        throw std::invalid_argument("opacities, harmonics, features: expected 1, 3 and 2 axes");
    }
    const py::ssize_t n = opacities.shape(0), k = harmonics.shape(1);
    if (k != 1 && k != 4 && k != 9 && k != 16) {
        throw std::invalid_argument("harmonics: expected 1, 4, 9 or 16 coefficients a colour");
    }
    if (n > std::numeric_limits<std::int32_t>::max()) {
        throw std::invalid_argument("positions: expected fewer than 2^31 Gaussians");
    }
    check(positions, "positions", {n, 3});
    check(rotations, "rotations", {n, 4});
    check(scales, "scales", {n, 3});
    check(harmonics, "harmonics", {n, k, 3});
    check(features, "features", {n, features.shape(1)});
    if (screen_offsets) {
        check(*screen_offsets, "screen_offsets", {n, 2});
    }
    auto p = std::make_unique<Picture>();
    p->gaussians = {static_cast<std::size_t>(n), static_cast<int>(k), static_cast<int>(features.shape(1)),
                    positions.data(), rotations.data(), scales.data(), opacities.data(), harmonics.data(), features.data(),
                    screen_offsets ? screen_offsets->data() : nullptr};
    p->positions = std::move(positions);
    p->rotations = std::move(rotations);
    p->scales = std::move(scales);
    p->opacities = std::move(opacities);
    p->harmonics = std::move(harmonics);
    p->features = std::move(features);
    p->screen_offsets = std::move(screen_offsets);
    {
        py::gil_scoped_release release;
        p->pass = std::make_unique<SplatPass>(camera, p->gaussians, threads);
    }
    return p;
}

py::tuple backward(const Picture& p, const Floats& image_bar, const Floats& transmittance_bar, int threads) {
    const py::ssize_t height = p.pass->camera().height, width = p.pass->camera().width;
    check(image_bar, "image_bar", {p.pass->channel_count(), height, width});
    check(transmittance_bar, "transmittance_bar", {height, width});
    SplatGradient g;
    {
        py::gil_scoped_release release;
        g = p.pass->backward(p.gaussians, image_bar.data(), transmittance_bar.data(), threads);
    }
    const auto n = static_cast<py::ssize_t>(p.gaussians.count);
    return py::make_tuple(to_array(std::move(g.positions), {n, 3}), to_array(std::move(g.rotations), {n, 4}),
                          to_array(std::move(g.scales), {n, 3}), to_array(std::move(g.opacities), {n}),
                          to_array(std::move(g.harmonics), {n, p.gaussians.harmonic_count, 3}),
                          to_array(std::move(g.features), {n, p.gaussians.feature_count}),
                          to_array(std::move(g.screen_offsets), {n, 2}));
}

py::tuple similarity(const Floats& first, const Floats& second, int threads) {
    if (first.ndim() != 3 || first.size() == 0) {
        throw std::invalid_argument("first: expected (channel, row, column)");
    }
    check(second, "second", {first.shape(0), first.shape(1), first.shape(2)});
    const int channels = static_cast<int>(first.shape(0));
    const int height = static_cast<int>(first.shape(1)), width = static_cast<int>(first.shape(2));
    Similarity s;
    {
        py::gil_scoped_release release;
        s = structural_similarity(first.data(), second.data(), channels, height, width, threads);
    }
    return py::make_tuple(s.value, to_array(std::move(s.first_bar), {channels, height, width}));
}

}  // namespace

void bind_splatting(py::module_& m) {
    py::class_<SplatCamera>(m, "SplatCamera")
        .def(py::init([](int width, int height, const Array<double>& focal, const Array<double>& centre,
                         const Array<double>& camera_from_world, double nearest, double blur) {
                 if (width < 1 || height < 1 || focal.size() != 2 || centre.size() != 2 || camera_from_world.size() != 16) {
                     throw std::invalid_argument("camera: expected a picture of at least one pixel, two focal lengths, "
                                                 "a principal point and a 4x4 matrix");
                 }
                 SplatCamera c;
                 c.width = width;
                 c.height = height;
                 std::copy_n(focal.data(), 2, c.focal);
                 std::copy_n(centre.data(), 2, c.centre);
                 std::copy_n(camera_from_world.data(), 12, &c.camera_from_world[0][0]);
                 c.nearest = nearest;
                 c.blur = blur;
                 return c;
             }),
             py::kw_only(), py::arg("width"), py::arg("height"), py::arg("focal"), py::arg("centre"), py::arg("camera_from_world"),
             py::arg("nearest"), py::arg("blur"));
    py::class_<Picture>(m, "SplatPicture")
        .def(py::init(&make_picture), py::kw_only(), py::arg("camera"), py::arg("positions"), py::arg("rotations"), py::arg("scales"),
             py::arg("opacities"), py::arg("harmonics"), py::arg("features"), py::arg("screen_offsets"), py::arg("threads"))
        .def_property_readonly("image",
                               [](const Picture& p) {
                                   const SplatPass& s = *p.pass;
                                   return py::array_t<float>({s.channel_count(), s.camera().height, s.camera().width}, s.image().data());
                               })
        .def_property_readonly("transmittance",
                               [](const Picture& p) {
                                   const SplatPass& s = *p.pass;
                                   return py::array_t<float>({s.camera().height, s.camera().width}, s.transmittance().data());
                               })
        .def_property_readonly("order",
                               [](const Picture& p) {
                                   const auto& order = p.pass->order();
                                   return py::array_t<std::int32_t>(static_cast<py::ssize_t>(order.size()), order.data());
                               })
        .def("backward", &backward, py::arg("image_bar"), py::arg("transmittance_bar"), py::arg("threads"));
    m.def("structural_similarity", &similarity, py::arg("first"), py::arg("second"), py::arg("threads"));
}

}  // namespace mphygs_python
