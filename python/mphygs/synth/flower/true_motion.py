"""The true motion of a flower: settled under its weight first, then moved by the hand.

Computed by the core's total-Lagrangian scheme on a finer grid than a fit's. Unlike a fit, which solves for
the stress-free shape behind the published one, this starts from a stress-free shape and lets it sag; what it
comes to is published.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from mphygs.capture.format import Capture, Hold, Known
from mphygs.capture.motions import hold_poses
from mphygs.capture.record import Sequence as Recording
from mphygs.model.belief import Belief
from mphygs.model.registry import effect
from mphygs.simulate.errors import SimulationError
from mphygs.simulate.fields import at_rest, core_effects, core_inputs, places
from mphygs.simulate.prediction import Settings
from mphygs.synth.flower.growth import Flower
from mphygs.synth.hidden import Hidden
from mphygs.synth.recipe import Recipe, Take
from mphygs.synth.truth import CausedPredictor, true_belief

# A flower comes to rest under its weight in rounds of this time [s] with this damping [1/s], about critical
# for the slowest swing of flowers like these, 1 to 4 Hz; until it is as slow as this [m/s], root of the mean
# square, after two rounds that follow each other: a swing stands still at its ends, but not twice.
SETTLING, SETTLING_DAMPING = 0.3, 14.0
SETTLING_ROUNDS, SETTLED_SPEED = 16, 2e-4
# Rounds that most flowers need.
USUAL_ROUNDS = 4
# Effects that shape the flower before anything is recorded, beside those that load it.
SHAPING = ("fibre", "stiffening", "compressibility", "stiffness_gradient", "density_gradient")


@dataclass(frozen=True, eq=False)
class Settled:
    """A flower at rest. vertices: (V, 3) of all parts, one after the other [m]; displacement: (N, 3) of the
    grid's nodes [m]; speed: what is left of it, root of the mean square [m/s]."""

    vertices: np.ndarray
    displacement: np.ndarray
    speed: float


class TrueMotion:
    """Simulates the takes of a recipe for the surface of its flower."""

    def __init__(self, flower: Flower, recipe: Recipe, hidden: Sequence[Hidden], spacing: float) -> None:
        self._recipe, self._take = recipe, recipe.takes[0]
        self._capture = Capture(
            recipe.name,
            Path(),
            recipe.shape.gravity,
            recipe.shape.parts,
            # the simulation starts before the flower has sagged
            "stress-free",
            Known(),
            (self._recording(self._take),),
        )
        self._belief = true_belief(self._capture, recipe, hidden)
        self._causes = [h for h in hidden if h.kind == "cause"]
        self._settings = Settings(spacing=spacing, workers=1)
        self._predictor = CausedPredictor(
            self._capture, self._capture.sequences[0], self._settings, self._causes
        )
        self.vertices = np.concatenate([part.vertices for part in flower.shape.parts])
        self._held = self._in_hold(self.vertices)
        counts = [len(part.vertices) for part in flower.shape.parts]
        self._node, self._value = self._weights(self.vertices, np.repeat(np.arange(len(counts)), counts))

    @property
    def blocks(self) -> int:
        """Number of blocks of quadrature points."""
        return self._predictor.body.block_count

    def settle(self, progress: Callable[[int], bool] | None = None) -> Settled:
        """The flower at rest under its weight and what else loads it; progress: called with the rounds done.

        Raises SimulationError where it does not come to rest.
        """
        calm = _calm(self._belief)
        predictor = self._predictor
        substep = self._substep(calm)
        steps = int(np.ceil(SETTLING / substep))
        schedule = {"steps": np.array([steps], np.int32), "dt": np.array([SETTLING / steps]), "start": 0.0}
        model = predictor.model(core_effects(calm), places(calm), calm.law)
        fields = core_inputs(calm, predictor.body)
        still = np.concatenate([np.eye(3).ravel(), np.zeros(3)])
        fields["pose"] = np.tile(still, (1, steps + 1, 1))
        before = np.inf
        for done in range(1, SETTLING_ROUNDS + 1):
            u, v = model.simulate(fields, schedule, None, None)
            fields["displacement0"], fields["velocity0"] = (np.asarray(a[-1], float) for a in (u, v))
            speed = float(np.sqrt((self._moved(fields["velocity0"]) ** 2).sum(axis=1).mean()))
            if max(speed, before) < SETTLED_SPEED:
                displacement = fields["displacement0"]
                return Settled(self.vertices + self._moved(displacement), displacement, speed)
            before = speed
            if progress is not None:
                progress(done)
        raise SimulationError(
            f"{self._recipe.name}: still moves at {speed:.2g} m/s after {SETTLING * SETTLING_ROUNDS:.1f} s "
            "of settling; it is too soft to carry its weight"
        )

    def run(
        self, take: Take, settled: Settled, progress: Callable[[int], bool] | None = None
    ) -> tuple[np.ndarray, int]:
        """Vertices (T, V, 3) [m] in all frames of a take, and the number of substeps.

        Raises SimulationError where the motion cannot be computed.
        """
        recording = self._recording(take)
        predictor = CausedPredictor(
            self._capture, recording, self._settings, self._causes, body=self._predictor.body
        )
        belief = self._belief
        model = predictor.model(core_effects(belief), places(belief), belief.law)
        timeline = predictor.timeline(belief, take.frames, self._substep(belief))
        fields = predictor.inputs(belief, timeline)
        fields["displacement0"] = settled.displacement
        u, _ = model.simulate(fields, timeline.schedule, progress, predictor.hook(belief, fields))
        position = np.stack([self.vertices + self._moved(np.asarray(frame, float)) for frame in u])
        rotation, shift = recording.held[0].poses(np.arange(take.frames) / take.fps, take.fps)
        held = self.vertices[self._held]
        position[:, self._held] = np.einsum("tij,mj->tmi", rotation, held) + shift[:, None]
        if not np.isfinite(position).all():
            raise SimulationError(f"{self._recipe.name}, {take.name}: the motion is not finite")
        return position, int(timeline.schedule["steps"].sum())

    def substeps(self, take: Take | None) -> int:
        """How many a take, or settling, will need."""
        seconds = USUAL_ROUNDS * SETTLING if take is None else take.frames / take.fps
        return int(seconds / self._substep(_calm(self._belief) if take is None else self._belief))

    def displaced(self, points: np.ndarray, settled: Settled) -> np.ndarray:
        """Where material points (M, 3) [m] of the stress-free shape are at rest, (M, 3) [m]."""
        node, value = self._weights(points)
        return points + np.einsum("mk,mkc->mc", value, settled.displacement[node])

    def hold(self, take: Take) -> Hold:
        """The hold of a take with its poses."""
        return self._recording(take).held[0]

    def _recording(self, take: Take) -> Recording:
        shape = self._recipe.shape
        poses = hold_poses(take.motions, np.arange(take.frames) / take.fps, shape.pivot)
        return Recording(take.name, take.fps, take.frames, held=(Hold(shape.hold, *poses),))

    def _substep(self, belief: Belief) -> float:
        return self._predictor.stable_substep(belief)

    def _in_hold(self, points: np.ndarray) -> np.ndarray:
        box = self._recipe.shape.hold
        return ((points >= box[0] - 1e-9) & (points <= box[1] + 1e-9)).all(axis=1)

    def _weights(self, points: np.ndarray, part: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Nodes (M, 27) and shares (M, 27) that carry material points (M, 3) of parts (M,), if given."""
        model = self._predictor.model((), np.zeros((0, 3)), self._belief.law)
        node, value, _ = model.weights(points, self._predictor.body.nearest_cell(points, part))
        return node, value

    def _moved(self, nodal: np.ndarray) -> np.ndarray:
        """(V, 3) of node values (N, 3), zero on what is held."""
        moved = np.einsum("mk,mkc->mc", self._value, nodal[self._node])
        moved[self._held] = 0.0
        return moved


def _calm(belief: Belief) -> Belief:
    """What shapes and loads the flower before anything is recorded, with damping that brings it to rest."""
    terms = tuple(t for t in at_rest(belief).terms if effect(t.name).loads_at_rest or t.name in SHAPING)
    return replace(belief, terms=terms).with_effect("mass_damping", {"alpha": SETTLING_DAMPING}, {})
