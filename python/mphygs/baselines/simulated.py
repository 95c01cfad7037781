"""What a baseline fits that moves an object by the simulator, with numbers of its own in the place of parts.

It is fitted through the simulation to markers, to the tracks of a capture in pictures or to the pictures
themselves, to more of the fitted frames from stage to stage, and begins at the best of a few moduli that are
the same everywhere. Density is not fitted; gravity is zero where the rest shape carries it.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from mphygs.baselines.mover import Learned
from mphygs.baselines.targets import Target, TrackTarget
from mphygs.baselines.training import Progress, TrainingPlan, Values, begun_at, train
from mphygs.fit.experiment import Experiment
from mphygs.fit.run import Run
from mphygs.model.belief import Belief
from mphygs.simulate.prediction import Maker
from mphygs.simulate.transfer import Start

# Shares of the fitted frames that the first stages see.
GROWING = (0.25, 0.5)


class Simulated(Learned):
    """The simulator with a material of a baseline's own."""

    @abstractmethod
    def take(self, values: Mapping[str, np.ndarray]) -> None:
        """Predict by other numbers from now on."""

    @abstractmethod
    def slopes(self, belief: Belief, last: int, bar: np.ndarray) -> Values:
        """Derivative of a loss by the numbers, for that by the markers' positions (T, M, 3)."""

    def stable_substep(self, belief: Belief) -> float:
        return super().stable_substep(weightless(belief))

    def _material(self, belief: Belief, start: Start | None) -> dict[str, np.ndarray]:
        return super()._material(weightless(belief), start)


def weightless(belief: Belief) -> Belief:
    """The belief without gravity, where its rest shape carries that."""
    if belief.prestress == "off":
        return belief
    return replace(belief, gravity=np.zeros(3), prestress="off")


@dataclass(frozen=True)
class Fitting:
    """How a baseline is fitted. name: in what is told; begun: its numbers at a power of ten times the usual
    stiffness; rates, stages, iterations: of `TrainingPlan`; penalty: what numbers cost, with slopes;
    opening: names of the numbers that alone are fitted in the first stage, none for all of them; pictures:
    whether costs are those of pictures."""

    name: str
    begun: Callable[[float], Values]
    rates: Mapping[str, float]
    stages: int
    iterations: int
    penalty: Callable[[Mapping[str, np.ndarray]], tuple[float, Values]] = lambda _: (0.0, {})
    opening: tuple[str, ...] = ()
    pictures: bool = False


def tracked(run: Run, experiment: Experiment, make: Maker) -> tuple[dict[str, Simulated], dict[str, Target]]:
    """Of every fitted sequence what moves its markers, and these. make: what makes the predictors, of
    `Simulated`, at any of the numbers."""
    problem = experiment.problem(run.settings.spacing)
    predictors = {name: problem.predictors[name] for name in problem.ranges}
    movers = {
        name: make(p.capture, p.recording, p.settings, body=p.body) for name, p in predictors.items()
    }
    return movers, {name: TrackTarget(problem.observations[name]) for name in movers}


def fit_simulated(
    run: Run,
    experiment: Experiment,
    progress: Progress,
    movers: Mapping[str, Simulated],
    targets: Mapping[str, Target],
    constants: Mapping[str, np.ndarray],
    how: Fitting,
) -> Run:
    """The complete run. movers, targets: of every fitted sequence what moves it, and what it shows;
    constants: what else predicting takes. Raises SimulationError where no modulus can be run."""
    problem = experiment.problem(run.settings.spacing)
    belief = replace(run.belief, parameters=tuple(replace(p, free=False) for p in run.belief.parameters))
    run = replace(run, belief=belief)

    def measure(values: Mapping[str, np.ndarray], number: int, slopes: bool = True) -> tuple[float, Values]:
        stage = number // how.iterations
        share = GROWING[stage] if stage < len(GROWING) else 1.0
        ranges = problem.narrowed(share).ranges if share < 1.0 else problem.ranges
        cost, weight = 0.0, 0.0
        total = {name: np.zeros_like(value) for name, value in values.items()}
        for name, mover in movers.items():
            span, target = ranges[name], targets[name]
            mover.take(values)
            own, bar = target.cost(mover.predict(belief, last=span[1]).position, span)
            cost, weight = cost + own, weight + target.weight(span)
            for key, slope in (mover.slopes(belief, span[1], bar) if slopes else {}).items():
                total[key] += slope
        extra, more = how.penalty(values)
        learning = how.opening if stage == 0 and how.opening else total
        gradient = {key: total[key] / weight + more.get(key, 0.0) for key in learning}
        return cost / weight + extra, gradient

    def start() -> Values:
        whole = how.stages * how.iterations
        told = {"name": how.name, "pictures": how.pictures}
        return begun_at(how.begun, lambda v: measure(v, whole, slopes=False)[0], progress, **told)

    begins = tuple((k + 1) * how.iterations for k in range(len(GROWING)))
    plan = TrainingPlan(how.rates, how.stages, how.iterations, begins=begins, pictures=how.pictures)
    run = train(run, start, measure, plan, constants, progress, name=how.name)
    return replace(run, covariance=np.zeros((0, 0)), information=np.zeros((0, 0)))
