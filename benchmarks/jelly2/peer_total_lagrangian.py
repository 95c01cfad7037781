"""This package's other transfer on the same column: what it simulates with where nothing tears or touches.

Its own scheme, not the one that the peers share: state on the grid's nodes, weights computed once.
"""

from pathlib import Path

import numpy as np
import trimesh
import workload as w

from mphygs.capture.format import Capture
from mphygs.capture.holds import Hold
from mphygs.capture.markers import Markers
from mphygs.capture.meshes import Part
from mphygs.capture.record import Known, Sequence
from mphygs.model.belief import Belief, Parameter
from mphygs.simulate.prediction import Predictor, Settings

PARTS = ("lower", "upper")


def column(work: w.Workload, steps: int) -> Capture:
    """The column as two boxes, clamped at its foot, and one frame of so many substeps."""
    side, height = work.positions.max(axis=0)[[0, 2]] + w.SPACING / 4
    middle = work.positions[work.material == 1, 2].min() - w.SPACING / 4
    parts = []
    for name, low, high in (("lower", 0.0, middle), ("upper", middle, height)):
        mesh = trimesh.creation.box(bounds=[(0.0, 0.0, low), (side, side, high)])
        parts.append(Part(name, np.asarray(mesh.vertices, float), np.asarray(mesh.faces, np.int64)))
    foot = np.array([[-1.0, -1.0, -1.0], [1.0, 1.0, work.positions[work.held, 2].max() + w.SPACING / 4]])
    top = np.array([[side / 2, side / 2, height]])
    seen = Sequence(
        "fall",
        1.0 / (steps * w.STEP),
        2,
        held=(Hold(foot, None, None),),
        markers=Markers(np.tile(top, (2, 1, 1)), top, 1e-4),
    )
    return Capture("jelly2", Path("."), np.array(w.GRAVITY), tuple(parts), "stress-free", Known(), (seen,))


def belief(young: tuple[float, float]) -> Belief:
    """Its materials."""
    parameters = []
    for part, modulus in zip(PARTS, young, strict=True):
        for key, value, unit in (
            ("youngs_modulus", modulus, "Pa"),
            ("density", w.DENSITY, "kg/m^3"),
            ("poissons_ratio", w.POISSON, "-"),
        ):
            positive = key != "poissons_ratio"
            parameters.append(
                Parameter(f"{part}.{key}", value, unit, 1e-3 if positive else 0.0, log=positive)
            )
    return Belief(PARTS, np.array(w.GRAVITY), tuple(parameters))


class Peer:
    """forward() -> final displacement (N, 3) of the nodes [m]; gradient() -> d(sum of its z)/dE of both."""

    def __init__(self, work: w.Workload, threads: int, double: bool = False) -> None:
        self.work = work
        settings = Settings(w.SPACING, workers=threads, dtype="float64" if double else "float32")
        self.predictors = {}
        for steps in {work.forward_steps, work.gradient_steps}:
            capture = column(work, steps)
            self.predictors[steps] = Predictor(capture, capture.sequences[0], settings)
        body = self.predictors[work.forward_steps].body
        self.part = body.point_part.ravel()
        self.count = body.quadrature.volumes.size

    def run(self, steps: int, young: tuple[float, float]) -> tuple:
        """The compiled model, its fields and its schedule."""
        predictor, model_of = self.predictors[steps], belief(young)
        timeline = predictor.timeline(model_of, 2, w.STEP)
        assert sum(timeline.schedule["steps"]) == steps
        model = predictor.model_of(model_of)
        predictor.transfer.share(model, predictor.workers)
        return model, predictor.inputs(model_of, timeline), timeline.schedule

    def forward(self, steps: int | None = None, young: tuple[float, float] = w.YOUNG) -> np.ndarray:
        """After the forward steps."""
        steps = steps or self.work.forward_steps
        predictor = self.predictors[steps]
        displacement, _ = predictor.transfer.simulate(*self.run(steps, young), None, None)
        return displacement[1]

    def gradient(self) -> np.ndarray:
        """By both E."""
        model, fields, schedule = self.run(self.work.gradient_steps, w.YOUNG)
        nodes = len(self.predictors[self.work.gradient_steps].transfer.places_at_rest())
        bar = np.zeros((2, nodes, 3), self.predictors[self.work.gradient_steps].settings.number)
        bar[1, :, 2] = 1
        bars, _ = model.adjoint(fields, schedule, bar, np.zeros(0, bar.dtype))
        mu, lame = w.lame_per_young()
        by_point = np.ravel(bars["mu"]).astype(float) * mu + np.ravel(bars["lambda"]).astype(float) * lame
        return np.bincount(self.part, by_point, minlength=2)
