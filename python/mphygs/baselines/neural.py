"""The elastic model and an unnamed residual network: what is missing, learnt without a name.

After Gao et al., "Sim-to-real of soft robots with learned residual physics" (2024): a network of the state
gives forces that the simulation lacks. Materials are fitted first, without it, and stay; it is then trained
in the loop, through the simulation, on the fitted frames, of which it sees more from stage to stage. Its
forces are held from one frame to the next.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property, partial

import numpy as np
import torch
from torch import Tensor

from mphygs.baselines.anchors import carried_points
from mphygs.baselines.mover import Mover
from mphygs.baselines.residual_network import (
    NAMES,
    SHAPES,
    Scales,
    Surroundings,
    acceleration,
    starting_weights,
)
from mphygs.baselines.training import Progress, TrainingPlan, Values, taken, train, trained_values
from mphygs.baselines.weights import as_tensors
from mphygs.fit.checkpointed import fit_run
from mphygs.fit.experiment import Experiment
from mphygs.fit.gradient_optimisers import Misfit
from mphygs.fit.run import TRAINED, Run
from mphygs.model.belief import Belief
from mphygs.simulate.errors import SimulationError
from mphygs.simulate.op import rollout
from mphygs.simulate.prediction import Maker, Predictor
from mphygs.simulate.timeline import Timeline

STAGES, ITERATIONS = 8, 8
# Of the work, the fit of the elastic model.
ELASTIC = 0.2
# Shares of the fitted frames that the first stages see.
GROWING = (0.25, 0.5)
RATE = 0.01
# What the squares of the network's weights cost, so that it says no more than it must.
DECAY = 1e-3
# Of the object's acceleration, what the network's output counts by.
OUTPUT = 0.5


class NeuralPredictor(Mover):
    """Predicts by the elastic model in the loop with a network. values: see `maker`."""

    def settle(self) -> None:
        self.scales = Scales.of(self.values["scales"])
        self._number = torch.float32 if self.settings.number is np.float32 else torch.float64

    @cached_property
    def elastic(self) -> Predictor:
        """The simulator without the network."""
        return Predictor(self.capture, self.recording, self.settings, body=self.body)

    def slopes(self, belief: Belief, last: int, keys: Sequence[str], like: np.ndarray) -> np.ndarray:
        """Of the elastic model alone: which way the numbers move the motion, not quite how far."""
        if not keys:
            return super().slopes(belief, last, keys, like)
        return self.elastic.predict(belief, last=last, keys=keys).jacobian

    def moved(self, belief: Belief, last: int) -> tuple[Timeline, np.ndarray, np.ndarray]:
        with torch.no_grad():
            timeline, u, v = self.loop(belief, last, as_tensors(self.values, NAMES))
        states = (u.numpy().astype(float), v.numpy().astype(float))
        position, velocity = self.carriers.observe(states, timeline, self.recording)
        if not np.isfinite(position).all():
            raise SimulationError("the motion is not finite")
        return timeline, position, velocity

    def loop(
        self, belief: Belief, last: int, weights: Mapping[str, Tensor]
    ) -> tuple[Timeline, Tensor, Tensor]:
        """Displacement [m] and velocity [m/s] of the nodes at the start and the moving frames, (F + 1, N, 3)
        each, differentiable by the weights. Raises SimulationError where a run is unstable."""
        timeline = self.timeline(belief, last, self.stable_substep(belief))
        model = self.model_of(belief)
        self.transfer.share(model, self.workers)
        fields = {k: self._tensor(v) for k, v in self.inputs(belief, timeline).items()}
        rest = self.transfer.places_at_rest()
        mass = np.asarray(model.node_mass(self.inputs(belief, timeline)), float).ravel()
        near = Surroundings(rest, np.maximum(mass, 1e-9 * mass.mean()), self.settings.spacing)
        poses, loads = fields.pop("pose", None), fields.pop("node_force", None)
        u = fields.pop("displacement0", torch.zeros(rest.shape, dtype=self._number))
        v = fields.pop("velocity0", torch.zeros(rest.shape, dtype=self._number))
        places, weight = self._tensor(rest), self._tensor(mass)[:, None]
        schedule, at, states = timeline.schedule, 0, [(u, v)]
        ends = np.r_[schedule["start"], timeline.times]
        rigid = [self._tensor(x) for x in self._rigid(rest, ends)]
        for k, steps in enumerate(schedule["steps"]):
            push = acceleration(weights, self.scales, near, places, places + u - rigid[k], v)
            force = weight * push.to(self._number)
            own = {"displacement0": u, "velocity0": v}
            own["node_force"] = (force if loads is None else force + loads[k])[None]
            if poses is not None:
                own["pose"] = poses[:, at : at + int(steps) + 1].contiguous()
            one = {name: schedule[name][k : k + 1] for name in ("steps", "dt")}
            moved, speed = rollout(model, fields | own, one | {"start": float(ends[k])})
            u, v, at = moved[-1], speed[-1], at + int(steps)
            states.append((u, v))
        return timeline, torch.stack([s[0] for s in states]), torch.stack([s[1] for s in states])

    def marker_bar(self, states: np.ndarray, timeline: Timeline, bar: np.ndarray) -> Tensor:
        """Derivative of a loss by the nodes' displacement, (F + 1, N, 3), for that by the markers' positions,
        (T, M, 3)."""
        none, count = np.zeros_like(bar), states.shape[1]
        return self._tensor(self.carriers.observe_adjoint((states, states), timeline, bar, none, count)[0])

    def _tensor(self, values: np.ndarray) -> Tensor:
        return torch.as_tensor(np.ascontiguousarray(values), dtype=self._number)

    def _rigid(self, rest: np.ndarray, times: np.ndarray) -> np.ndarray:
        """(S, N, 3) places of points (N, 3) [m] that the first hold carried, at times (S,) [s]."""
        hold = np.full(len(rest), 0 if self.recording.held else -1)
        return carried_points(self.recording, times, rest, hold)



def maker(run: Run) -> Maker:
    """Predictors by the network of a finished run."""
    values = trained_values(run)
    shapes = dict(zip(NAMES, SHAPES, strict=True)) | {"scales": (10,)}
    found = dict(zip(shapes, taken(values, run.folder, shapes), strict=True))
    if not (found["scales"][3:] > 0.0).all():
        raise ValueError(f"{run.folder / TRAINED}: scales: expected lengths and speeds above zero")
    return partial(NeuralPredictor, found)


def fit(run: Run, experiment: Experiment, progress: Progress) -> Run:
    """The complete run: materials, then the network. Raises SimulationError where the fit cannot start."""
    run = fit_run(run, experiment, progress=lambda share, line: progress(ELASTIC * share, line))
    problem = experiment.problem(run.settings.spacing)
    belief = run.belief
    movers: dict[str, NeuralPredictor] = {}
    scales = scales_of(experiment, belief, run.settings.spacing)
    for name in problem.ranges:
        p = problem.predictors[name]
        values = starting_weights(run.seed) | {"scales": scales.numbers}
        movers[name] = NeuralPredictor(values, p.capture, p.recording, p.settings, body=p.body)

    def measure(values: Mapping[str, np.ndarray], number: int) -> tuple[float, Values]:
        stage = number // ITERATIONS
        share = GROWING[stage] if stage < len(GROWING) else 1.0
        ranges = problem.narrowed(share).ranges if share < 1.0 else problem.ranges
        cost, rows = 0.0, 0
        weights = as_tensors(values, NAMES, slopes=True)
        for name, mover in movers.items():
            first, last = ranges[name]
            timeline, u, v = mover.loop(belief, last, weights)
            states = u.detach().numpy().astype(float)
            position, _ = mover.carriers.observe((states, v.detach().numpy()), timeline, mover.recording)
            misfit = Misfit(problem.observations[name], first, last)
            bar = misfit.slope(position)
            u.backward(mover.marker_bar(states, timeline, bar))
            cost += misfit.cost
            rows += problem.observations[name].whitener(first, last).row_count
        slopes = {name: w.grad.numpy().astype(float) / rows for name, w in weights.items()}
        size = sum(float(np.sum(values[name] ** 2)) for name in NAMES)
        return cost / rows + 0.5 * DECAY * size, {n: g + DECAY * values[n] for n, g in slopes.items()}

    plan = TrainingPlan(
        dict.fromkeys(NAMES, RATE), STAGES, ITERATIONS,
        begins=tuple((k + 1) * ITERATIONS for k in range(len(GROWING))),
    )  # fmt: skip

    def later(share: float, line: str) -> None:
        progress(ELASTIC + (1.0 - ELASTIC) * share, line)

    constants = {"scales": scales.numbers}
    return train(
        run, lambda: starting_weights(run.seed), measure, plan, constants, later, name="neural"
    )


def scales_of(experiment: Experiment, belief: Belief, spacing: float) -> Scales:
    """From the elastic motion of the fitted frames."""
    problem = experiment.problem(spacing)
    sizes = []
    for name, (_, last) in problem.ranges.items():
        p = problem.predictors[name]
        timeline = p.timeline(belief, last, p.stable_substep(belief))
        u, v = (np.asarray(x, float) for x in p.states(belief, timeline)[:2])
        rest = p.transfer.places_at_rest()
        mass = np.asarray(p.model_of(belief).node_mass(p.inputs(belief, timeline)), float).ravel()
        near = Surroundings(rest, np.maximum(mass, 1e-9 * mass.mean()), spacing)
        ends = np.r_[timeline.schedule["start"], timeline.times][-len(u) :]
        hold = np.full(len(rest), 0 if p.recording.held else -1)
        moved = rest + u - carried_points(p.recording, ends, rest, hold)
        share = mass / mass.sum()

        def size(field: np.ndarray, share: np.ndarray = share) -> float:
            return float(np.einsum("n,tnc->", share, field**2) / len(field))

        apart = [
            np.stack([near.apart(torch.as_tensor(x, dtype=torch.float32), spacing).numpy() for x in field])
            for field in (moved, v)
        ]
        pushed = np.diff(v, axis=0) / np.maximum(timeline.spans[:, None, None], 1e-9)
        sizes.append([size(x) for x in (moved, v, *apart, pushed)])
    found = np.maximum(np.sqrt(np.mean(sizes, axis=0)), 1e-9)
    points = problem.predictors[next(iter(problem.ranges))].body.quadrature.points.reshape(-1, 3)
    middle = points.mean(0)
    place = float(np.sqrt(((points - middle) ** 2).sum(1).mean()))
    displacement, velocity, *near_by, pushed = (float(x) for x in found)
    sizes = (displacement, velocity, *near_by, OUTPUT * pushed, spacing)
    return Scales(tuple(middle), place, *sizes)
