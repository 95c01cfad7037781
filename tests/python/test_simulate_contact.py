"""A wall is met where the surface is."""

from __future__ import annotations

import numpy as np
import pytest

from bar_capture import bar_belief, bar_capture
from mphygs.model.belief import Belief
from mphygs.simulate.prediction import Predictor, Settings

SPACING = 0.01
SIZE = np.array([0.06, 0.02, 0.02])
FLOOR = -0.008
EDGE = np.array([[0.06, 0.0, 0.0], [0.06, 0.02, 0.0], [0.06, 0.01, 0.0]])


def falling() -> tuple[Predictor, Belief]:
    """A soft bar, held at one end, that falls on a floor with the lower edge of the other, which is seen."""
    capture = bar_capture(frames=16, fps=100.0, fit=(0, 16), markers_at=EDGE)
    belief = bar_belief(capture, youngs_modulus=2e4)
    settings = Settings(SPACING, workers=1, dtype="float64")
    return Predictor(capture, capture.sequences[0], settings), belief


def test_where_a_wall_may_be_met_the_surface_is_points_on_it() -> None:
    body = falling()[0].body
    middles, corners = body.geometry, body.corners
    assert corners["surface_area"].sum() == pytest.approx(middles["surface_area"].sum(), rel=1e-9)
    real = corners["surface_area"].ravel() > 0
    points = corners["surface_points"].reshape(-1, 3)[real]
    gap = np.minimum(points - [-0.006, 0.0, 0.0], SIZE - points)
    np.testing.assert_allclose(gap.min(axis=1), 0.0, atol=1e-9)
    for edge in EDGE[:2]:
        assert np.linalg.norm(points - edge, axis=1).min() < 1e-9
        lumps = middles["surface_points"].reshape(-1, 3)[middles["surface_area"].ravel() > 0]
        assert np.linalg.norm(lumps - edge, axis=1).min() > 1e-3
    # Every point is carried by its own cell, the free ones of a block by the same.
    cell = np.repeat(corners["surface_cell"], 8, axis=0)[real]
    np.testing.assert_array_equal(cell, body.nearest_cell(points, np.zeros(len(points), int)))


def test_an_edge_stops_at_the_floor() -> None:
    predictor, belief = falling()
    floor = {"d": FLOOR, "n_x": 0.0, "n_y": 0.0, "n_z": 1.0, "mu": 0.3}
    met = predictor.predict(belief.with_effect("contact", floor)).position[..., 2]
    free = predictor.predict(belief).position[..., 2]
    assert free.min() < FLOOR - 0.01
    assert FLOOR - 5e-4 < met.min() < FLOOR
