"""Young's modulus as a smooth field without parts: the representation of PhysDreamer.

Zhang et al., "PhysDreamer: physics-based interaction with 3D objects via video generation" (2024): a triplane
and a small network give log E at every point, smooth by the total variation of the planes; density is not
fitted. There gravity is zero, for the rest shape carries it; so it is here, but for a rest shape without
stress, which falls. Fitted to markers, or to the tracks of a capture in pictures, through the simulation, to
more of the fitted frames from stage to stage; it begins at the best of a few moduli that are the same
everywhere.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import grid_sample

from mphygs.baselines.mover import Learned
from mphygs.baselines.training import Plan, Progress, Values, begun_at, taken, train, trained_values
from mphygs.baselines.weights import as_tensors
from mphygs.fit.experiment import Experiment
from mphygs.fit.gradient_optimisers import Misfit
from mphygs.fit.run import TRAINED, Run
from mphygs.model.belief import Belief
from mphygs.simulate.batches import Owned
from mphygs.simulate.measurement import before_measurement
from mphygs.simulate.prediction import Maker
from mphygs.simulate.prediction_gradient import field_slopes
from mphygs.simulate.timeline import Timeline
from mphygs.simulate.transfer import Start

# Points to a side of a plane, its channels, and units of the layer behind.
RESOLUTION, CHANNELS, WIDTH = 8, 8, 32
SHAPES = {
    "planes": (3, CHANNELS, RESOLUTION, RESOLUTION),
    "weight0": (WIDTH, 3 * CHANNELS),
    "bias0": (WIDTH,),
    "weight1": (1, WIDTH),
    "level": (1,),
}
RATES = {"planes": 0.02, "weight0": 0.01, "bias0": 0.01, "weight1": 0.01, "level": 0.05}
STAGES, ITERATIONS = 8, 8
# Shares of the fitted frames that the first stages see.
GROWING = (0.25, 0.5)
# What total variation costs, and the logarithm of E beyond which it is cut off.
VARIATION, FARTHEST = 1e-4, 8.0


class FieldPredictor(Learned):
    """Predicts by a field of E. values: see `maker`."""

    def settle(self) -> None:
        self.points = torch.as_tensor(self.body.quadrature.points.reshape(-1, 3), dtype=torch.float32)
        self.box = self.values["box"]
        self.take(self.values)

    def take(self, values: Mapping[str, np.ndarray]) -> None:
        """Predict by other numbers from now on."""
        self.values = {**values, "box": self.box}
        with torch.no_grad():
            found = field_at(as_tensors(values, SHAPES), self.points, self.box)
        self.factor = np.exp(found.numpy().astype(float)).reshape(self.body.quadrature.points.shape[:2])
        self.forget()

    def stable_substep(self, belief: Belief) -> float:
        # the largest frequency rises with the root of the stiffness
        return super().stable_substep(weightless(belief)) / max(float(self.factor.max()), 1e-12) ** 0.5

    def _material(self, belief: Belief, start: Start | None) -> dict[str, np.ndarray]:
        fields = super()._material(weightless(belief), start)
        return fields | {name: fields[name] * self.factor for name in ("mu", "lambda")}

    def changes(
        self, belief: Belief, owned: Sequence[Owned], timeline: Timeline, start: Start | None = None
    ) -> list[dict[str, np.ndarray]]:
        own = weightless(belief)
        moved = [(own if owner is belief else weightless(owner), parameter) for owner, parameter in owned]
        return [
            {k: v * self.factor if k in ("mu", "lambda") else v for k, v in change.items()}
            for change in super().changes(own, moved, timeline, start)
        ]


def weightless(belief: Belief) -> Belief:
    """The belief without gravity, where its rest shape carries that."""
    if belief.prestress == "off":
        return belief
    return replace(belief, gravity=np.zeros(3), prestress="off")


def field_at(weights: Mapping[str, Tensor], points: Tensor, box: np.ndarray) -> Tensor:
    """(N,) logarithm of E over the usual at points (N, 3) [m]. box: (2, 3) [m] of the object."""
    low, high = (torch.as_tensor(side, dtype=points.dtype) for side in box)
    at = torch.clamp(2.0 * (points - low) / (high - low) - 1.0, -1.0, 1.0)
    seen = []
    for plane, axes in zip(weights["planes"], ([0, 1], [0, 2], [1, 2]), strict=True):
        seen.append(grid_sample(plane[None], at[None, None][..., axes], align_corners=True)[0, :, 0].T)
    hidden = torch.relu(torch.cat(seen, dim=1) @ weights["weight0"].T + weights["bias0"])
    return torch.clamp((hidden @ weights["weight1"].T)[:, 0] + weights["level"], -FARTHEST, FARTHEST)


def maker(run: Run) -> Maker:
    """Predictors by the field of a finished run."""
    shapes = SHAPES | {"box": (2, 3)}
    found = dict(zip(shapes, taken(trained_values(run), run.folder, shapes), strict=True))
    if not (found["box"][1] > found["box"][0]).all():
        raise ValueError(f"{run.folder / TRAINED}: box: expected a lower and an upper corner")
    return partial(FieldPredictor, found)


def starting_weights(seed: int) -> dict[str, np.ndarray]:
    """Weights by name of a field that is the same everywhere."""
    generator = np.random.default_rng(seed)
    out = {name: np.zeros(shape) for name, shape in SHAPES.items()}
    out["planes"] = 0.1 * generator.standard_normal(SHAPES["planes"])
    out["weight0"] = generator.standard_normal(SHAPES["weight0"]) / np.sqrt(3 * CHANNELS)
    return out


def fit(run: Run, experiment: Experiment, progress: Progress) -> Run:
    """The complete run of the field. Raises SimulationError where no modulus can be run."""
    problem = experiment.problem(run.settings.spacing)
    belief = replace(run.belief, parameters=tuple(replace(p, free=False) for p in run.belief.parameters))
    run = replace(run, belief=belief)
    box = np.asarray(experiment.capture.bounds, float)
    begun = starting_weights(run.seed)
    movers = {}
    for name in problem.ranges:
        p = problem.predictors[name]
        values = begun | {"box": box}
        movers[name] = FieldPredictor(values, p.capture, p.recording, p.settings, body=p.body)

    def measure(values: Mapping[str, np.ndarray], number: int, slopes: bool = True) -> tuple[float, Values]:
        stage = number // ITERATIONS
        share = GROWING[stage] if stage < len(GROWING) else 1.0
        ranges = problem.narrowed(share).ranges if share < 1.0 else problem.ranges
        weights = as_tensors(values, SHAPES, slopes=slopes)
        cost, rows = 0.0, 0
        for name, mover in movers.items():
            first, last = ranges[name]
            mover.take(values)
            position = mover.predict(belief, last=last).position
            misfit = Misfit(problem.observations[name], first, last)
            bar = misfit.slope(position)
            cost += misfit.cost
            rows += problem.observations[name].whitener(first, last).row_count
            if slopes:
                by_field = torch.as_tensor(_slope(mover, belief, last, bar), dtype=torch.float32)
                field_at(weights, mover.points, box).backward(by_field)
        if not slopes:
            return cost / rows, {}
        planes = weights["planes"]
        rough = (planes[..., 1:, :] - planes[..., :-1, :]).abs().mean()
        rough = VARIATION * (rough + (planes[..., 1:] - planes[..., :-1]).abs().mean())
        found = {name: w.grad.numpy().astype(float) / rows for name, w in weights.items()}
        found["planes"] += torch.autograd.grad(rough, planes)[0].numpy()
        return cost / rows + float(rough.detach()), found

    def start() -> Values:
        return begun_at(
            lambda power: begun | {"level": np.array([power * np.log(10.0)])},
            lambda values: measure(values, ITERATIONS * STAGES, slopes=False)[0],
            progress,
            name="field",
        )

    plan = Plan(
        RATES, STAGES, ITERATIONS, begins=tuple((k + 1) * ITERATIONS for k in range(len(GROWING)))
    )
    run = train(run, start, measure, plan, {"box": box}, progress, name="field")
    return replace(run, covariance=np.zeros((0, 0)), information=np.zeros((0, 0)))


def _slope(mover: FieldPredictor, belief: Belief, last: int, bar: np.ndarray) -> np.ndarray:
    """(N,) derivative of a loss by the field at the points, for that by the markers' positions (T, M, 3)."""
    timeline = mover.timeline(belief, last, mover.stable_substep(belief))
    seen = before_measurement(belief, timeline.frames / mover.recording.fps, bar)
    bars, fields, _ = field_slopes(mover, belief, timeline, None, seen)
    return sum(bars[name].ravel() * np.asarray(fields[name], float).ravel() for name in ("mu", "lambda"))
