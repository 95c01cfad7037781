"""How sure a step is of what it found."""

from __future__ import annotations

import numpy as np
import pytest

from bar_capture import bar_belief, bar_capture
from extend_example import recorded
from mphygs.extend.grids import known_budget, with_budget
from mphygs.extend.steps import step_at, uncertainty
from mphygs.fit.experiment import Experiment
from mphygs.fit.levenberg_marquardt import covariance, minimise
from mphygs.simulate.prediction import Settings

COARSE, FINE = 0.01, 0.005
KEY = "part0.youngs_modulus"


def test_a_coarse_grid_is_not_sure_of_the_stiffness() -> None:
    """Recorded on a fine grid and fitted on a coarse one, the stiffness is off by many of the noise's
    deviations, and by few of those that a refinement adds."""
    capture = bar_capture(frames=24, fps=100.0, fit=(0, 24))
    truth = bar_belief(capture, youngs_modulus=6e4, free=(KEY,))
    experiment = Experiment.of(recorded(capture, truth, FINE), Settings(COARSE, workers=1))
    belief = minimise(experiment.problem(COARSE), experiment.starting(truth), iterations=8).belief
    plain = step_at(experiment, belief, COARSE)
    assert not known_budget(plain)
    noise = covariance(plain.solution.evaluation)
    assert uncertainty(plain) == pytest.approx(noise)
    known = with_budget(experiment, plain)
    assert known_budget(known)
    off = abs(np.log(belief[KEY].value / 6e4))
    noise_std, std = (float(np.sqrt(c[0, 0])) for c in (noise, uncertainty(known)))
    assert off > 5.0 * noise_std
    assert 0.4 * off < std < 2.5 * off
