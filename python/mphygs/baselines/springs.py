"""Springs between anchors, each with a stiffness of its own: the representation of Spring-Gaus.

See `mphygs.baselines.spring_system`. Points follow the anchors by moving least squares and not by their mean,
which would blur; a shape that carries its weight at rest feels none; anchors on what is held move with it.
Fitted, through all steps of the motion: the stiffness of every anchor, softness of far springs, damping.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial

import numpy as np

from mphygs.baselines.anchors import Anchors, holds_of
from mphygs.baselines.mover import Mover, start_of
from mphygs.baselines.spring_system import SPRINGS, Course, SpringRun, Springs
from mphygs.baselines.training import Progress, TrainingPlan, Values, begun_at, taken, train, trained_values
from mphygs.capture.format import Capture
from mphygs.fit.experiment import Experiment
from mphygs.fit.gradient_optimisers import Misfit
from mphygs.fit.run import Run
from mphygs.model.belief import Belief
from mphygs.simulate.errors import SimulationError
from mphygs.simulate.prediction import Maker
from mphygs.simulate.timeline import Timeline

ANCHORS = 100
STAGES, ITERATIONS = 12, 5
RATES = {"k": 0.05, "softness": 0.1, "damping": 0.1}
SOFTNESS, DAMPING = 0.0, 0.1  # damping: [m/s], of a spring over its length


class SpringPredictor(Mover):
    """Predicts by springs. values: see `maker`."""

    def settle(self) -> None:
        rest = self.values["anchors"]
        self.anchors = Anchors(rest, holds_of(rest, self.values["held"], self.body.boxes))
        self.springs = Springs.of(rest)
        self.rows = self.anchors.weights(self.attachment.anchor + self.attachment.offset)

    def run(self, belief: Belief, last: int, values: Mapping[str, np.ndarray]) -> tuple[Timeline, SpringRun]:
        """The anchors' motion with these numbers. Raises SimulationError where it diverges."""
        softness, damping = float(values["softness"][0]), float(np.exp(values["damping"][0]))
        if np.abs(values["k"]).max() > 12.0 or not damping < 1e6:
            raise SimulationError("springs: stiff without bound")
        stiffness = self.springs.stiffness(values["k"], softness)
        timeline = self.timeline(belief, last, self.springs.longest_step(stiffness, damping))
        place, velocity = start_of(self, belief, self.anchors.rest)
        count = len(timeline.moving)
        course = Course(
            timeline.schedule["steps"], timeline.schedule["dt"], ~self.anchors.free,
            self.anchors.carried(self.recording, timeline.substep_times()),
            np.tile(self._weight(belief), (count, len(place), 1)) + self._loads(timeline, belief),
        )  # fmt: skip
        return timeline, SpringRun.of(self.springs, stiffness, damping, course, place, velocity)

    def moved(self, belief: Belief, last: int) -> tuple[Timeline, np.ndarray, np.ndarray]:
        timeline, run = self.run(belief, last, self.values)
        return timeline, *self.observed(timeline, run)

    def observed(self, timeline: Timeline, run: SpringRun) -> tuple[np.ndarray, np.ndarray]:
        """Positions [m] and velocities [m/s] of the markers, (T, M, 3)."""
        steps = run.frames
        return self.following(self.rows, self.anchors, timeline, run.place[steps], run.velocity[steps])

    def marker_bar(self, timeline: Timeline, bar: np.ndarray, count: int) -> np.ndarray:
        """Derivative of a loss by the anchors' places at a run's frames, (count, n, 3), for that by the
        markers' positions, (T, M, 3)."""
        out = np.zeros((count, *self.anchors.rest.shape))
        free = self.attachment.hold < 0
        for k, frame in enumerate(bar[timeline.shown]):
            out[k + timeline.skipped] = self.rows[free].T @ frame[free]
        return out

    def _weight(self, belief: Belief) -> np.ndarray:
        return self.body.towards(belief.gravity) if belief.prestress == "off" else np.zeros(3)

    def _loads(self, timeline: Timeline, belief: Belief) -> np.ndarray:
        """(F, n, 3) acceleration by known loads, of anchors that share the object's mass [m/s^2]."""
        out = np.zeros((len(timeline.moving), *self.anchors.rest.shape))
        for load, acting in self.acting(timeline):
            rest = self.anchors.rest
            inside = ((rest >= load.box[0]) & (rest <= load.box[1])).all(1) & self.anchors.free
            if not inside.any():
                distance = np.linalg.norm(rest - load.box.mean(0), axis=1)
                inside = distance == distance[self.anchors.free].min()
            mass = self.mass(belief) / len(rest)
            each = np.asarray(load.force, float) / (mass * inside.sum())
            out[:, inside] += acting[:, None, None] * each
        return out


def maker(run: Run) -> Maker:
    """Predictors by the springs of a finished run."""
    values = trained_values(run)
    shapes = {"anchors": (None, 3), "held": (None,), "k": (None,), "softness": (1,), "damping": (1,)}
    found = dict(zip(shapes, taken(values, run.folder, shapes), strict=True))
    count = len(found["anchors"])
    taken(values, run.folder, shapes | {"anchors": (count, 3), "held": (count,), "k": (count,)})
    return partial(SpringPredictor, found)


def fit(run: Run, experiment: Experiment, progress: Progress) -> Run:
    """The complete run of springs. Raises SimulationError where no stiffness can be run."""
    problem = experiment.problem(run.settings.spacing)
    first = next(iter(problem.predictors.values()))
    anchors = Anchors.of(first.body, ANCHORS)
    constants = {"anchors": anchors.rest, "held": (~anchors.free).astype(float)}
    none = {"k": np.zeros(len(anchors.rest)), "softness": np.zeros(1), "damping": np.zeros(1)}
    movers = {
        name: SpringPredictor(constants | none, p.capture, p.recording, p.settings, body=p.body)
        for name, p in problem.predictors.items()
        if name in problem.ranges
    }
    belief = replace(run.belief, parameters=tuple(replace(p, free=False) for p in run.belief.parameters))
    run = replace(run, belief=belief)

    def measure(values: Mapping[str, np.ndarray], number: int, slopes: bool = True) -> tuple[float, Values]:
        cost, rows = 0.0, 0
        out = {name: np.zeros_like(value) for name, value in values.items()}
        for name, mover in movers.items():
            span = problem.ranges[name]
            timeline, moved = mover.run(belief, span[1], values)
            position, _ = mover.observed(timeline, moved)
            misfit = Misfit(problem.observations[name], *span)
            bar = misfit.slope(position)
            cost, rows = cost + misfit.cost, rows + problem.whitener(name).row_count
            if slopes:
                at_anchors = mover.marker_bar(timeline, bar, len(moved.frames))
                by_stiffness, by_damping = moved.gradient(at_anchors)
                softness = float(values["softness"][0])
                by_k, by_softness = mover.springs.stiffness_slopes(values["k"], softness, by_stiffness)
                out["k"] += by_k
                out["softness"] += by_softness
                out["damping"] += by_damping * np.exp(values["damping"])
        return cost / rows, {name: slope / rows for name, slope in out.items()}

    def start() -> Values:
        usual = _usual(belief, experiment.capture, Springs.of(anchors.rest))
        damping = {"softness": np.array([SOFTNESS]), "damping": np.array([np.log(DAMPING)])}

        def values_at(power: float) -> Values:
            return damping | {"k": np.full(len(anchors.rest), usual + power)}

        return begun_at(values_at, lambda v: measure(v, 0, slopes=False)[0], progress, name="springs")

    plan = TrainingPlan(RATES, STAGES, ITERATIONS)
    run = train(run, start, measure, plan, constants, progress, name="springs")
    return replace(run, covariance=np.zeros((0, 0)), information=np.zeros((0, 0)))


def _usual(belief: Belief, capture: Capture, springs: Springs) -> float:
    """k of springs that are as stiff as a belief's material: springs in all directions alike have E / rho =
    N 10^k L / 10, by the mean of the fourth power of a cosine, 1/5, and half a spring to each of its ends."""
    volume = sum(part.volume for part in capture.parts)
    ratio = sum(
        part.volume * belief[f"{part.name}.youngs_modulus"].value / belief[f"{part.name}.density"].value
        for part in capture.parts
    )
    count = min(SPRINGS, len(np.unique(springs.first)) - 1)
    return float(np.log10(10.0 * ratio / volume / (count * springs.length[springs.pair].mean())))
