"""Young's modulus as a smooth field without parts: the representation of PhysDreamer.

Zhang et al., "PhysDreamer: physics-based interaction with 3D objects via video generation" (2024): a triplane
and a small network give log E at every point, smooth by the total variation of the planes; another such field
gives the velocity at which the motion begins; density is not fitted. There gravity is zero, for the rest
shape carries it; so it is here, but for a rest shape without stress, which falls. In pictures the loss is
that of the pictures alone: the velocity is fitted first, to the first frames, then both to more of the fitted
frames from stage to stage. To markers E alone is fitted, and motions begin as the capture states it. E
begins at the best of a few moduli that are the same everywhere.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
import torch

from mphygs.baselines import triplane
from mphygs.baselines.simulated import Fitting, Simulated, fit_simulated, tracked, weightless
from mphygs.baselines.targets import Pictures
from mphygs.baselines.training import Progress, Values, taken, trained_values
from mphygs.baselines.weights import as_tensors
from mphygs.capture.format import Capture
from mphygs.capture.record import Sequence as Recording
from mphygs.fit.experiment import Experiment
from mphygs.fit.of_run import pictured_of
from mphygs.fit.run import TRAINED, Run, capture_digest
from mphygs.model.belief import Belief
from mphygs.simulate.batches import Owned
from mphygs.simulate.body import Body
from mphygs.simulate.prediction import Maker
from mphygs.simulate.prediction_gradient import field_slopes
from mphygs.simulate.settings import Settings
from mphygs.simulate.timeline import Timeline
from mphygs.simulate.transfer import Start

STIFFNESS = triplane.shapes(1) | {"level": (1,)}
VELOCITY = triplane.shapes(3)
RATES = triplane.RATES | {"level": 0.05}
STAGES, ITERATIONS = 8, 8
# What total variation costs of E and of the velocity, and the logarithm of E beyond which it is cut off.
VARIATION, VELOCITY_VARIATION, FARTHEST = 1e-4, 1e-2, 8.0
# What a velocity of one means: so many times the object's longest side in a second.
SPEED = 0.1


class FieldPredictor(Simulated):
    """Predicts by a field of E, and of sequences whose numbers are there by one of the velocity at the start.
    values: see `maker`."""

    def settle(self) -> None:
        self.points = torch.as_tensor(self.body.quadrature.points.reshape(-1, 3), dtype=torch.float32)
        self.carried = torch.as_tensor(self.transfer.places_at_rest(), dtype=torch.float32)
        self.box = self.values["box"]
        self.unit = SPEED * float(np.ptp(self.box, axis=0).max())
        self.own = {name: f"velocity.{self.recording.name}.{name}" for name in VELOCITY}
        self.take(self.values)

    def take(self, values: Mapping[str, np.ndarray]) -> None:
        self.values = {**values, "box": self.box}
        with torch.no_grad():
            found = self._log_factor(as_tensors(values, STIFFNESS))
        self.factor = np.exp(found.numpy().astype(float)).reshape(self.body.quadrature.points.shape[:2])
        self.velocity = None
        if self.own["planes"] in values:
            with torch.no_grad():
                self.velocity = self._velocity(self._weights_of_velocity()).numpy().astype(float)
        self.forget()

    def _log_factor(self, weights: Mapping[str, torch.Tensor]) -> torch.Tensor:
        """(N,) logarithm of E over the usual at the points."""
        found = triplane.field_at(weights, self.points, self.box)[:, 0] + weights["level"]
        return torch.clamp(found, -FARTHEST, FARTHEST)

    def _velocity(self, weights: Mapping[str, torch.Tensor]) -> torch.Tensor:
        """(n, 3) of the carriers at the start [m/s]."""
        return self.unit * triplane.field_at(weights, self.carried, self.box)

    def _weights_of_velocity(self, *, slopes: bool = False) -> dict[str, torch.Tensor]:
        own = {name: self.values[key] for name, key in self.own.items()}
        return as_tensors(own, VELOCITY, slopes=slopes)

    def stable_substep(self, belief: Belief) -> float:
        # the largest frequency rises with the root of the stiffness
        return super().stable_substep(belief) / max(float(self.factor.max()), 1e-12) ** 0.5

    def _material(self, belief: Belief, start: Start | None) -> dict[str, np.ndarray]:
        fields = super()._material(belief, start)
        fields = fields | {name: fields[name] * self.factor for name in ("mu", "lambda")}
        if self.velocity is not None and start is None:
            fields["velocity0"] = fields.get("velocity0", 0.0) + self.velocity
        return fields

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
        by_field, by_velocity = self.field_slopes(belief, last, bar)
        weights = as_tensors(self.values, STIFFNESS, slopes=True)
        self._log_factor(weights).backward(torch.as_tensor(by_field, dtype=torch.float32))
        found = {name: w.grad.numpy().astype(float) for name, w in weights.items()}
        if self.velocity is not None:
            weights = self._weights_of_velocity(slopes=True)
            self._velocity(weights).backward(torch.as_tensor(by_velocity, dtype=torch.float32))
            found |= {self.own[name]: w.grad.numpy().astype(float) for name, w in weights.items()}
        return found

    def field_slopes(self, belief: Belief, last: int, bar: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Derivative of a loss by the logarithm of E at the points, (N,), and by the velocity of the carriers
        at the start, (n, 3), for that by the markers' positions (T, M, 3)."""
        timeline = self.timeline(belief, last, self.stable_substep(belief))
        bars, fields, _ = field_slopes(self, belief, timeline, None, lambda _: [bar])
        by_field = sum(bars[k].ravel() * np.asarray(fields[k], float).ravel() for k in ("mu", "lambda"))
        return by_field, np.asarray(bars["velocity0"], float).reshape(-1, 3)


def maker(run: Run) -> Maker:
    """Predictors by the fields of a finished run; of the velocities, those of the run's own capture."""
    values = trained_values(run)
    told = {key for key in values if key.startswith("velocity.")}
    velocities = {
        f"velocity.{name}.{weight}": shape for name in run.ranges for weight, shape in VELOCITY.items()
    }
    shapes = STIFFNESS | {"box": (2, 3)} | (velocities if told else {})
    found = dict(zip(shapes, taken(values, run.folder, shapes), strict=True))
    if not (found["box"][1] > found["box"][0]).all():
        raise ValueError(f"{run.folder / TRAINED}: box: expected a lower and an upper corner")

    def make(
        capture: Capture, recording: Recording, settings: Settings, *, body: Body | None = None
    ) -> FieldPredictor:
        own = told and capture_digest(capture) == run.digest
        known = found if own else {key: found[key] for key in found if key not in velocities}
        return FieldPredictor(known, capture, recording, settings, body=body)

    return make


def starting_weights(seed: int, sequences: Sequence[str] = ()) -> dict[str, np.ndarray]:
    """Weights by name of a field of E that is the same everywhere, and of no velocity in sequences."""
    generator = np.random.default_rng(seed)
    out = triplane.flat_weights(1, generator) | {"level": np.zeros(1)}
    for name in sequences:
        own = triplane.flat_weights(3, generator)
        out |= {f"velocity.{name}.{weight}": value for weight, value in own.items()}
    return out


def fit(run: Run, experiment: Experiment, progress: Progress) -> Run:
    """The complete run of the field. Raises SimulationError where no modulus can be run."""
    box = np.asarray(experiment.capture.bounds, float)
    begun = starting_weights(run.seed, () if run.stages is None else tuple(experiment.fitted))
    velocities = {key: RATES[key.rpartition(".")[2]] for key in begun if key.startswith("velocity.")}
    how = Fitting(
        "field", lambda power: begun | {"level": np.array([power * np.log(10.0)])}, RATES | velocities,
        STAGES, ITERATIONS, roughness, opening=tuple(velocities), pictures=run.stages is not None,
    )  # fmt: skip
    make = partial(FieldPredictor, begun | {"box": box})
    pictured = pictured_of(run, replace(experiment, make=make))
    if pictured is None:
        movers, targets = tracked(run, experiment, make)
    else:
        movers = {name: pictured.predictor(name) for name in experiment.fitted}
        targets = {name: Pictures.of(pictured, name, span) for name, span in experiment.fitted.items()}
    return fit_simulated(run, experiment, progress, movers, targets, {"box": box}, how)


def roughness(values: Mapping[str, np.ndarray]) -> tuple[float, Values]:
    """What the total variation of the planes costs, and its derivative by them."""
    cost, slopes = 0.0, {}
    for key, value in values.items():
        if key.rpartition(".")[2] == "planes":
            share = VARIATION if key == "planes" else VELOCITY_VARIATION
            rough, slope = triplane.total_variation(value)
            cost, slopes[key] = cost + share * rough, share * slope
    return cost, slopes
