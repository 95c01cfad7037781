"""This package: its compiled MLS-MPM transfer, called as the rest of the package calls it."""

import numpy as np
import workload as w

from mphygs import _core


class Peer:
    """forward() -> final positions (N, 3) [m]; gradient() -> d(sum of final z)/dE of both materials."""

    def __init__(self, work: w.Workload, threads: int, double: bool = False, budget: int = 2 << 30) -> None:
        self.work = work
        self.dtype = np.float64 if double else np.float32
        model = _core.MlsMpmFloat64 if double else _core.MlsMpmFloat32
        geometry = {
            "spacing": w.SPACING,
            "points": work.positions,
            "part": work.material,
            "hold": np.where(work.held, 0, -1),
            "hold_count": 1,
            "part_count": 2,
        }
        settings = {"threads": threads, "hold_relaxation": w.RELAXATION, "memory_budget": budget}
        self.model = model(geometry, settings)
        self.effects = sum(len(e["parameters"]) for e in _core.effects())

    def fields(self, steps: int, young: tuple[float, float]) -> dict[str, np.ndarray]:
        """The inputs of a run."""
        modulus = np.asarray(young)[self.work.material]
        mu, lame = w.lame_per_young()
        pose = np.concatenate([np.eye(3).ravel(), np.zeros(3)])
        arrays = {
            "mu": modulus * mu,
            "lambda": modulus * lame,
            "stress_volume": np.full(self.work.count, self.work.volume),
            "mass": np.full(self.work.count, self.work.mass),
            "effect": np.zeros(self.effects),
            "gravity": np.array(w.GRAVITY),
            "pose": np.tile(pose, (steps + 1, 1)),
        }
        return {name: a.astype(self.dtype) for name, a in arrays.items()}

    def forward(self, steps: int | None = None, young: tuple[float, float] = w.YOUNG) -> np.ndarray:
        """Final positions after the forward steps."""
        steps = steps or self.work.forward_steps
        position, _, _ = self.model.simulate(self.fields(steps, young), {"steps": [steps], "dt": [w.STEP]})
        return position[1]

    def gradient(self) -> np.ndarray:
        """Derivative of the sum of all final heights by both E."""
        steps = self.work.gradient_steps

        def loss(position: np.ndarray, velocity: np.ndarray, deformation: np.ndarray) -> tuple:
            bar = np.zeros_like(position)
            bar[1, :, 2] = 1
            return bar, None, None

        bars, _ = self.model.gradient(self.fields(steps, w.YOUNG), {"steps": [steps], "dt": [w.STEP]}, loss)
        mu, lame = w.lame_per_young()
        by_particle = bars["mu"].astype(np.float64) * mu + bars["lambda"].astype(np.float64) * lame
        return np.bincount(self.work.material, by_particle, minlength=2)
