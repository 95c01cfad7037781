"""A mixture of laws of elasticity in every group of points: the representation of OmniPhysGS.

Lin et al., "OmniPhysGS: 3D constitutive Gaussians for general physics-based dynamics generation" (2025): the
object is cut into small groups of points, and each obeys one of a few laws, by weights that a network tells;
stiffness and Poisson's ratio are the same everywhere. Here the weights of every group are fitted themselves,
through the simulation, and the stress is the sum of what the laws say, each by its share. The one stiffness
is fitted as well. Of four laws one resists a change of volume alone, so that a group may be softer than
others; there are no plastic ones.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property, partial

import numpy as np
from scipy.spatial import cKDTree

from mphygs.baselines.law_mixture import (
    CORE_LAW,
    LAWS,
    MixtureStress,
    core_bar,
    core_fields,
    slopes_of,
    strengths_of,
)
from mphygs.baselines.simulated import Fitting, Simulated, fit_simulated, tracked, weightless
from mphygs.baselines.training import Progress, Values, taken, trained_values
from mphygs.fit.experiment import Experiment
from mphygs.fit.run import Run
from mphygs.model.belief import Belief
from mphygs.simulate.batches import Owned
from mphygs.simulate.fields import core_inputs
from mphygs.simulate.prediction import Maker, Predictor
from mphygs.simulate.prediction_gradient import field_slopes
from mphygs.simulate.scope import belief_of_sequence
from mphygs.simulate.transfer import Start

# Groups that an object is cut into, and stages of so many iterations.
GROUPS = 24
STAGES, ITERATIONS = 8, 8
RATES = {"weights": 0.2, "level": 0.05}


class LawsPredictor(Simulated):
    """Predicts by a mixture of laws. values: see `maker`."""

    def settle(self) -> None:
        self.centres = self.values["centres"]
        points = self.body.quadrature.points.reshape(-1, 3)
        self.group = cKDTree(self.centres).query(points)[1].astype(np.int64)
        self.take(self.values)

    def take(self, values: Mapping[str, np.ndarray]) -> None:
        self.values = {**values, "centres": self.centres}
        self.strengths = strengths_of(self.values["weights"], self.values["level"])
        self.forget()

    def model_of(self, belief: Belief) -> object:
        return super().model_of(replace(belief, law=CORE_LAW))

    @cached_property
    def _elastic(self) -> Predictor:
        """The simulator with one law."""
        return Predictor(self.capture, self.recording, self.settings, body=self.body)

    def stable_substep(self, belief: Belief) -> float:
        # At rest all laws are as stiff, but for one that is less; the largest frequency rises with the root.
        usual = self._elastic.stable_substep(weightless(belief))
        return usual / float(np.exp(0.5 * self.values["level"][0]))

    def _material(self, belief: Belief, start: Start | None) -> dict[str, np.ndarray]:
        fields = super()._material(belief, start)
        own = self.strengths[self.group].reshape(*fields["mu"].shape, len(LAWS))
        return fields | core_fields(own, fields["mu"], fields["lambda"])

    def _hook(
        self,
        belief: Belief,
        fields: dict,
        simulated: Sequence[Owned] = (),
        changes: Sequence[dict] = (),
        number: type | None = None,
    ) -> MixtureStress:
        if simulated:
            raise ValueError("a mixture of laws: expected no derivatives by what else is believed")
        return MixtureStress(self.strengths, self.group, *self._usual(belief), number or self.settings.number)

    def _usual(self, belief: Belief) -> tuple[np.ndarray, np.ndarray]:
        """(N,) each, Lame's parameters as believed [Pa]."""
        fields = core_inputs(belief_of_sequence(belief, self.recording.name), self.body)
        return fields["mu"].ravel(), fields["lambda"].ravel()

    def slopes(self, belief: Belief, last: int, bar: np.ndarray) -> Values:
        timeline = self.timeline(belief, last, self.stable_substep(belief))
        bars, _, hook = field_slopes(self, belief, timeline, None, lambda _: [bar])
        by_core = np.zeros((len(self.centres), 2))
        np.add.at(by_core, self.group, core_bar(bars, *self._usual(belief)))
        return slopes_of(self.strengths, np.hstack([by_core, hook.bar]))


def centres_of(points: np.ndarray, count: int, seed: int) -> np.ndarray:
    """(G, 3) of points (N, 3) [m], so many at most, each the farthest from those before it."""
    found = [points[np.random.default_rng(seed).integers(len(points))]]
    away = np.full(len(points), np.inf)
    while len(found) < min(count, len(points)):
        away = np.minimum(away, np.linalg.norm(points - found[-1], axis=1))
        found.append(points[away.argmax()])
    return np.array(found)


def maker(run: Run) -> Maker:
    """Predictors by the mixture of a finished run."""
    shapes = {"weights": (None, len(LAWS)), "level": (1,), "centres": (None, 3)}
    found = dict(zip(shapes, taken(trained_values(run), run.folder, shapes), strict=True))
    shapes = {"centres": (len(found["weights"]), 3)}
    taken(found, run.folder, shapes)
    return partial(LawsPredictor, found)


def fit(run: Run, experiment: Experiment, progress: Progress) -> Run:
    """The complete run of the mixture. Raises SimulationError where no stiffness can be run."""
    problem = experiment.problem(run.settings.spacing)
    quadrature = problem.predictors[next(iter(problem.ranges))].body.quadrature
    points = quadrature.points.reshape(-1, 3)[quadrature.volumes.ravel() > 0.0]
    centres = centres_of(points, GROUPS, run.seed)
    even = {"weights": np.zeros((len(centres), len(LAWS)))}
    how = Fitting(
        "laws", lambda power: even | {"level": np.array([power * np.log(10.0)])}, RATES, STAGES, ITERATIONS
    )
    make = partial(LawsPredictor, even | {"level": np.zeros(1), "centres": centres})
    movers, targets = tracked(run, experiment, make)
    return fit_simulated(run, experiment, progress, movers, targets, {"centres": centres}, how)
