"""Materials from looks alone, and no fit: what Pixie does.

Le et al., "Pixie: fast and generalizable supervised learning of 3D physics from pixels" (2025): a network
learns materials of places of an object from examples whose materials are known, and another object is
simulated with what it says. Here the examples are grown flowers (`mphygs.synth.flower.looks`), a place is
told by its colour, that of what is near and where on the object it stands, and a part has the mean over its
particles. The network is trained anew by every run, from its seed.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor

from mphygs.baselines.training import Progress, TrainingPlan, Values, train, trained_values
from mphygs.fit.experiment import Experiment
from mphygs.fit.of_run import pictured_of
from mphygs.fit.run import Run
from mphygs.fit.stage_particles import particles_of
from mphygs.model.belief import Belief
from mphygs.scene.gaussians import CONSTANT_HARMONIC

INPUTS, WIDTH, OUTPUTS = 8, 32, ("log10 E", "log10 rho")
SHAPES = {
    "weight0": (WIDTH, INPUTS),
    "bias0": (WIDTH,),
    "weight1": (WIDTH, WIDTH),
    "bias1": (WIDTH,),
    "weight2": (len(OUTPUTS), WIDTH),
    "bias2": (len(OUTPUTS),),
}
STAGES, ITERATIONS, BATCH, RATE = 5, 200, 512, 5e-3
# Points whose mean colour is that of what is near.
NEAR = 24
# Numbers scale between these quantiles of the examples.
LOWEST, HIGHEST = 0.01, 0.99


@dataclass(frozen=True, eq=False)
class Examples:
    """Places whose materials are known. shown: (N, INPUTS), see `shown_of`; material: (N, 2), see OUTPUTS."""

    shown: np.ndarray
    material: np.ndarray


def shown_of(points: np.ndarray, colour: np.ndarray, up: np.ndarray) -> np.ndarray:
    """(N, INPUTS) what a network sees of points (N, 3) [m] of one object, with colours (N, 3) of 0 to 1: its
    colour, that of what is near, and in heights of the object how high and how far from its middle it is."""
    near = cKDTree(points).query(points, min(NEAR, len(points)))[1].reshape(len(points), -1)
    level = points @ up
    height = max(float(np.ptp(level)), 1e-9)
    across = points - np.outer(level, up)
    away = np.linalg.norm(across - np.median(across, axis=0), axis=1)
    return np.column_stack([colour, colour[near].mean(1), (level - level.min()) / height, away / height])


def fit(run: Run, experiment: Experiment, progress: Progress, examples: Callable[[], Examples]) -> Run:
    """The complete run: the network trained on examples, and the materials that it says.

    Raises ValueError for a capture without pictures.
    """
    pictured = pictured_of(run, experiment)
    if pictured is None or run.stages is None:
        raise ValueError(f"{run.folder}: has no pictures; expected a capture in pictures for its looks")
    known = examples()
    low, high = np.quantile(known.material, [LOWEST, HIGHEST], axis=0)
    span = np.maximum(high - low, 1e-6)
    wanted = torch.as_tensor((known.material - low) / span, dtype=torch.float32)
    shown = torch.as_tensor(known.shown, dtype=torch.float32)
    generator = np.random.default_rng([run.seed, 0])
    start = {
        name: np.zeros(shape) if "bias" in name else generator.standard_normal(shape) / np.sqrt(shape[-1])
        for name, shape in SHAPES.items()
    }

    def measure(values: Mapping[str, np.ndarray], number: int) -> tuple[float, Values]:
        weights = {n: torch.as_tensor(v, dtype=torch.float32).requires_grad_() for n, v in values.items()}
        some = np.random.default_rng([run.seed, 1, number]).integers(len(shown), size=BATCH)
        cost = 0.5 * ((network(weights, shown[some]) - wanted[some]) ** 2).mean()
        cost.backward()
        return float(cost.detach()), {n: w.grad.numpy().astype(float) for n, w in weights.items()}

    def whole(values: Values) -> float:
        """Of all examples."""
        with torch.no_grad():
            weights = {n: torch.as_tensor(v, dtype=torch.float32) for n, v in values.items()}
            return float(0.5 * ((network(weights, shown) - wanted) ** 2).mean())

    plan = TrainingPlan(dict.fromkeys(SHAPES, RATE), STAGES, ITERATIONS, whole)
    run = train(run, lambda: start, measure, plan, {"low": low, "high": high}, progress, name="prior")
    gaussians = pictured.drawn.gaussians
    up = -np.asarray(experiment.capture.gravity, float)
    up = up / max(float(np.linalg.norm(up)), 1e-12)
    seen = shown_of(gaussians.positions.numpy().astype(float), colours_of(gaussians.harmonics.numpy()), up)
    values = trained_values(run)
    with torch.no_grad():
        weights = {n: torch.as_tensor(values[n], dtype=torch.float32) for n in SHAPES}
        said = network(weights, torch.as_tensor(seen, dtype=torch.float32)).numpy()
    material = low + span * np.clip(said, -0.1, 1.1)
    particles = particles_of(run.stages, len(run.belief.parts))
    near = cKDTree(gaussians.positions.numpy()).query(particles.position)[1]
    inside = particles.inside
    belief = run.belief
    for k, part in enumerate(belief.parts):
        own = near[inside & (particles.label == k)]
        belief = with_material(belief, part, (material[own] if len(own) else material).mean(0))
        told = (f"{belief[f'{part}.{name}'].value:.3g}" for name in ("youngs_modulus", "density"))
        progress(1.0, f"prior: {part}: E {next(told)} Pa, {next(told)} kg/m^3 by its looks")
    belief = replace(belief, parameters=tuple(replace(p, free=False) for p in belief.parameters))
    return replace(run, belief=belief, covariance=np.zeros((0, 0)), information=np.zeros((0, 0)))


def network(weights: Mapping[str, Tensor], shown: Tensor) -> Tensor:
    """(N, 2) scaled materials of places (N, INPUTS)."""
    x = torch.relu(shown @ weights["weight0"].T + weights["bias0"])
    x = torch.relu(x @ weights["weight1"].T + weights["bias1"])
    return x @ weights["weight2"].T + weights["bias2"]


def colours_of(harmonics: np.ndarray) -> np.ndarray:
    """(N, 3) colours, 0 to 1, from all sides alike, of harmonics (N, K, 3)."""
    return np.clip(0.5 + CONSTANT_HARMONIC * harmonics[:, 0], 0.0, 1.0).astype(float)


def with_material(belief: Belief, part: str, material: np.ndarray) -> Belief:
    """A belief with a part's materials (2,), see OUTPUTS; what the capture knows of them stays."""
    said = {"youngs_modulus": 10.0 ** float(material[0]), "density": 10.0 ** float(material[1])}
    for name, value in said.items():
        parameter = belief[f"{part}.{name}"]
        if parameter.free:
            value = float(np.clip(value, parameter.lower, parameter.upper))
            belief = belief.with_parameter(parameter.key, value=value)
    return belief
