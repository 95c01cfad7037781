"""How pulls at markers are spread: what is asked for is done, nothing is driven, holds stay."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.sparse import identity, kron

from bar_capture import bar_belief, bar_capture
from mphygs.simulate.feedback import Feedback
from mphygs.simulate.prediction import Predictor
from mphygs.simulate.rows import held_rows
from mphygs.simulate.settings import Settings
from mphygs.simulate.transfer import Start

SPACING, FRAMES = 0.01, 40
SIZE = np.array([0.06, 0.02, 0.02])


def scene(markers: int, seed: int, *, off: float = 0.0, along: float = 0.9) -> tuple[Predictor, Feedback]:
    """A bar of two parts with markers on it up to a share of its length, that stand `off` its surface [m]."""
    random = np.random.default_rng(seed)
    at = random.uniform(0.1, 0.9, (markers, 3)) * SIZE
    at[:, 0] *= along / 0.9
    at[:, 2] = SIZE[2] + off
    capture = bar_capture(
        lengths=(0.03, 0.03), frames=FRAMES, fps=100.0, markers_at=at, gravity=np.zeros(3)
    )
    predictor = Predictor(capture, capture.sequence("a"), Settings(SPACING, workers=1, dtype="float64"))
    return predictor, predictor.pulled_by(capture.sequence("a").markers.position, 1.0)


def of_markers(feedback: Feedback) -> np.ndarray:
    """H G: what markers are given of what they ask for."""
    blocks = feedback.reach.shape[1] > feedback.rows.shape[0]
    rows = kron(feedback.rows, identity(3)) if blocks else feedback.rows
    return (rows @ feedback.reach).toarray()


@pytest.mark.parametrize(("markers", "off"), [(1, 0.0), (3, 0.0), (5, 0.01), (8, 0.004), (200, 0.0)])
def test_no_marker_is_given_the_opposite_of_what_it_asks_for(markers: int, off: float) -> None:
    _, feedback = scene(markers, markers, off=off)
    given = np.linalg.eigvals(of_markers(feedback))
    assert np.abs(given.imag).max() < 1e-7 and given.real.min() > -1e-9
    # Few markers are given no more than they ask for; a force on a face moves it before what lies below.
    assert given.real.max() < (1.0 if feedback.reach.shape[1] > markers else 5.0)


@pytest.mark.parametrize("markers", [1, 4])
def test_what_few_markers_ask_for_is_done(markers: int) -> None:
    _, feedback = scene(markers, 7)
    given = of_markers(feedback)
    assert len(given) == 3 * markers and np.allclose(given, np.eye(3 * markers), atol=0.05)


def test_dense_markers_move_the_centre_of_mass_as_they_ask() -> None:
    predictor, feedback = scene(200, 1)
    assert feedback.reach.shape == feedback.rows.shape[::-1]
    body = predictor.body
    node, value, _ = predictor.model_of(bar_belief(predictor.capture)).weights(
        body.quadrature.points.reshape(-1, 3), body.point_cell
    )
    share = (value * body.quadrature.volumes.reshape(-1, 1)).ravel()
    volume = np.bincount(node.ravel(), share, minlength=feedback.reach.shape[0])
    given = feedback.reach @ np.ones(feedback.rows.shape[0])
    assert np.isclose(volume @ given, volume.sum(), rtol=0.02)


def test_few_markers_carry_what_is_beyond_them_along() -> None:
    predictor, feedback = scene(2, 3, along=0.5)
    places = predictor.transfer.places_at_rest()
    given = (feedback.reach @ np.tile([0.0, 0.0, 1.0], 2)).reshape(-1, 3)
    last = feedback.rest[:, 0].max()
    beyond = places[:, 0] > last + 0.005
    held = held_rows(predictor.body, predictor.model_of(bar_belief(predictor.capture)).node_index)
    # A bar that is asked to go up swings up: its end beyond the markers too, its hold not.
    assert beyond.any() and np.median(given[beyond, 2]) > 0.8
    assert held.shape[0] > 0 and np.abs(held @ given).max() < 0.05


@pytest.mark.parametrize(("markers", "off"), [(2, 0.01), (4, 0.006), (200, 0.0)])
def test_feedback_drives_nothing(markers: int, off: float) -> None:
    predictor, feedback = scene(markers, markers + 20, off=off)
    belief = bar_belief(predictor.capture, youngs_modulus=1e5)
    timeline = predictor.timeline(belief, FRAMES, predictor.stable_substep(belief))
    places = predictor.transfer.places_at_rest()
    speed = np.maximum(places[:, :1], 0.0) ** 2 * np.array([0.0, 60.0, 40.0])
    still = np.zeros_like(places)
    start = Start(0, still, speed, np.zeros((len(places), 3, 3)))
    free, pulled = (
        np.linalg.norm(predictor.states(belief, timeline, start, pull)[0], axis=(1, 2))
        for pull in (None, feedback)
    )
    # Wanted at rest, it comes to rest: what is free swings on.
    assert free[-5:].max() > 0.5 * free.max()
    assert pulled[-5:].max() < 0.45 * pulled.max()
