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
