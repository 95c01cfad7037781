"""An independent finite-element simulator's captures: with the true effects the fit reaches the noise."""

from __future__ import annotations

import pytest

from capture_example import shared
from mphygs.capture.format import load_capture
from mphygs.fit.experiment import Experiment
from mphygs.fit.schedule import fit_belief
from mphygs.fit.spacings import default_spacing
from mphygs.fit.start import starting_belief
from mphygs.simulate.prediction import Settings

HIGHEST = 1.1  # residual over the noise, per coordinate


@pytest.mark.slow
@pytest.mark.parametrize(("case", "effects"), [("p1", ()), ("p3", ("viscosity",))])
def test_fitted_and_unseen_frames_reach_the_noise(case: str, effects: tuple[str, ...]) -> None:
    capture = load_capture(shared("practice", case))
    settings = Settings(default_spacing(capture))
    experiment = Experiment.of(capture, settings)
    spacing = settings.spacing
    experiment.problem(spacing)
    belief = experiment.starting(starting_belief(capture, effects=effects))
    solution, _ = fit_belief(
        capture, belief, experiment.fitted, experiment.observations, settings, problems=experiment.problems
    )
    compared = experiment.compare(solution.belief, spacing, jacobian=False)
    seen = {}
    for name, one in compared.items():
        observation = one.observation
        for kind, (first, last) in (("fit", one.fit), ("predict", one.predict)):
            if last > first:
                misfit = (observation.position - one.predicted)[first:last][observation.observed[first:last]]
                seen[name, kind] = float((misfit**2).mean() ** 0.5 / capture.sequence(name).markers.sigma)
    assert any(kind == "fit" for _, kind in seen) and any(kind == "predict" for _, kind in seen)
    assert max(seen.values()) <= HIGHEST, seen
