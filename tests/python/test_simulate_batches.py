"""Candidates that are differentiated together have the derivatives that they have alone."""

from __future__ import annotations

import numpy as np
import pytest

from bar_capture import bar_belief, bar_capture
from mphygs.diagnose.candidates import base_motion_ways, smooth_ways
from mphygs.simulate.prediction import Predictor, Settings


@pytest.mark.parametrize("workers", [1, 2])
def test_unlike_constants_of_one_effect_do_not_mix(workers: int) -> None:
    capture = bar_capture(frames=12, fps=100.0, fit=(0, 12))
    belief = bar_belief(capture, youngs_modulus=6e4, free=())
    predictor = Predictor(capture, capture.sequences[0], Settings(0.01, workers=workers, dtype="float64"))
    ways = smooth_ways(belief, predictor.body, names=["relaxation", "wind", "tether", "gravity"])
    ways += base_motion_ways(belief, [3.0, 9.0])
    columns = [pair for way in ways for pair in way.columns]
    together = predictor.predict(belief, candidates=columns).jacobian
    assert len(columns) > 25
    for k, column in enumerate(columns):
        alone = predictor.predict(belief, candidates=[column]).jacobian[..., 0]
        name = f"{column[1].key} of column {k}"
        assert np.abs(alone).max() > 0.0, name
        assert together[..., k] == pytest.approx(alone, rel=1e-9, abs=1e-12 * np.abs(alone).max()), name
    # and they are unlike: sine and cosine, slow and fast
    sines = together[..., -12:].reshape(-1, 4, 3)[..., 1]
    cosine = sines.T @ sines / np.outer(*[np.linalg.norm(sines, axis=0)] * 2)
    assert (np.abs(cosine - np.eye(4)) < 0.999).all()


@pytest.mark.parametrize("rest", ["stress-free", "equilibrium"])
@pytest.mark.parametrize("count", [1, 2, 3, 4, 5])
def test_directions_that_share_a_register_are_those_told_alone(rest: str, count: int) -> None:
    shake = 0.01 * np.sin(np.linspace(0.0, 6.0, 10))[:, None] * [0.3, 1.0, 0.4]
    capture = bar_capture(frames=10, fps=100.0, fit=(0, 10), rest=rest, motion=shake)
    mode = "equilibrium" if rest == "equilibrium" else "off"
    keys = ("part0.youngs_modulus", "part0.density")
    belief = bar_belief(capture, youngs_modulus=6e4, free=keys, prestress=mode)
    predictor = Predictor(capture, capture.sequences[0], Settings(0.01, workers=1, dtype="float32"))
    columns = [(belief, belief[key]) for key in keys]
    columns += smooth_ways(belief, predictor.body, names=["gravity"])[0].columns
    assert len(columns) == 5
    chosen = columns[:count]
    together = predictor.predict(belief, candidates=chosen).jacobian
    precise = Predictor(capture, capture.sequences[0], Settings(0.01, workers=1, dtype="float64"))
    for k, column in enumerate(chosen):
        alone = predictor.predict(belief, candidates=[column]).jacobian[..., 0]
        assert np.abs(alone).max() > 0.0
        # The same operations in the same order, lane by lane; in another program they may be contracted.
        assert together[..., k] == pytest.approx(alone, rel=1e-4, abs=1e-5 * np.abs(alone).max())
        true = precise.predict(belief, candidates=[column]).jacobian[..., 0]
        assert together[..., k] == pytest.approx(true, rel=1e-2, abs=1e-3 * np.abs(true).max())
