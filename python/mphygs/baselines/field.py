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
from functools import partial

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import grid_sample

from mphygs.baselines.simulated import Fitting, Simulated, fit_simulated, weightless
from mphygs.baselines.training import Progress, Values, taken, trained_values
from mphygs.baselines.weights import as_tensors
from mphygs.fit.experiment import Experiment
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
# What total variation costs, and the logarithm of E beyond which it is cut off.
VARIATION, FARTHEST = 1e-4, 8.0


class FieldPredictor(Simulated):
    """Predicts by a field of E. values: see `maker`."""

    def settle(self) -> None:
        self.points = torch.as_tensor(self.body.quadrature.points.reshape(-1, 3), dtype=torch.float32)
        self.box = self.values["box"]
        self.take(self.values)

    def take(self, values: Mapping[str, np.ndarray]) -> None:
        self.values = {**values, "box": self.box}
        with torch.no_grad():
            found = field_at(as_tensors(values, SHAPES), self.points, self.box)
        self.factor = np.exp(found.numpy().astype(float)).reshape(self.body.quadrature.points.shape[:2])
        self.forget()

    def stable_substep(self, belief: Belief) -> float:
        # the largest frequency rises with the root of the stiffness
        return super().stable_substep(belief) / max(float(self.factor.max()), 1e-12) ** 0.5

    def _material(self, belief: Belief, start: Start | None) -> dict[str, np.ndarray]:
        fields = super()._material(belief, start)
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

    def slopes(self, belief: Belief, last: int, bar: np.ndarray) -> Values:
        weights = as_tensors(self.values, SHAPES, slopes=True)
        by_field = torch.as_tensor(self.field_slope(belief, last, bar), dtype=torch.float32)
        field_at(weights, self.points, self.box).backward(by_field)
        return {name: w.grad.numpy().astype(float) for name, w in weights.items()}

    def field_slope(self, belief: Belief, last: int, bar: np.ndarray) -> np.ndarray:
        """(N,) derivative of a loss by the field at the points, for that by the markers' positions
        (T, M, 3)."""
        timeline = self.timeline(belief, last, self.stable_substep(belief))
        seen = before_measurement(belief, timeline.frames / self.recording.fps, bar)
        bars, fields, _ = field_slopes(self, belief, timeline, None, seen)
        return sum(bars[name].ravel() * np.asarray(fields[name], float).ravel() for name in ("mu", "lambda"))


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
    box = np.asarray(experiment.capture.bounds, float)
    begun = starting_weights(run.seed)
    how = Fitting(
        "field", lambda power: begun | {"level": np.array([power * np.log(10.0)])}, RATES, STAGES, ITERATIONS,
        penalty=roughness,
    )  # fmt: skip
    make = partial(FieldPredictor, begun | {"box": box})
    return fit_simulated(run, experiment, progress, make, {"box": box}, how)


def roughness(values: Mapping[str, np.ndarray]) -> tuple[float, Values]:
    """What the total variation of the planes costs, and its derivative by them."""
    planes = torch.as_tensor(values["planes"], dtype=torch.float32).requires_grad_()
    rough = (planes[..., 1:, :] - planes[..., :-1, :]).abs().mean()
    rough = VARIATION * (rough + (planes[..., 1:] - planes[..., :-1]).abs().mean())
    rough.backward()
    return float(rough.detach()), {"planes": planes.grad.numpy().astype(float)}
