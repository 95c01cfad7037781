"""What predicts a sequence in the simulator's place: another model of how an object's points move."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Self

import numpy as np
from scipy.sparse import csr_matrix

from mphygs.baselines.anchors import Anchors, carried_points
from mphygs.capture.format import Capture
from mphygs.capture.holds import Load
from mphygs.capture.record import Sequence as Recording
from mphygs.model.belief import Belief
from mphygs.simulate.body import Body
from mphygs.simulate.errors import SimulationError
from mphygs.simulate.feedback import Feedback
from mphygs.simulate.prediction import Prediction, Predictor
from mphygs.simulate.section import part_mass
from mphygs.simulate.settings import Settings
from mphygs.simulate.timeline import Timeline
from mphygs.simulate.transfer import Start

if TYPE_CHECKING:
    from mphygs.simulate.batches import Owned

# Step of the differences that give the velocity of a hold [s].
_TICK = 1e-4


class Learned(Predictor):
    """A predictor by numbers that a baseline has learnt.

    values: by name, see the `maker` of the baseline; the others: of `Predictor`.
    """

    def __init__(
        self, values: Mapping[str, np.ndarray], capture: Capture, recording: Recording, settings: Settings, *,
        body: Body | None = None,
    ) -> None:  # fmt: skip
        super().__init__(capture, recording, settings, body=body)
        self.values = values
        self.settle()

    @abstractmethod
    def settle(self) -> None:
        """What follows from the numbers for the sequence. Raises ValueError where they do not fit it."""

    def alike(self, settings: Settings) -> Self:
        return type(self)(self.values, self.capture, self.recording, settings, body=self.body)


class Mover(Learned):
    """A predictor whose motion comes from elsewhere; grid, markers and holds are the simulator's.

    The belief tells when a sequence is let go and how it begins; its numbers have slopes only where `slopes`
    knows some.
    """

    @abstractmethod
    def moved(self, belief: Belief, last: int) -> tuple[Timeline, np.ndarray, np.ndarray]:
        """Frames and steps of frames 0..last-1, and positions [m] and velocities [m/s] of the markers,
        (T, M, 3). Raises SimulationError where the motion is not finite."""

    def following(
        self,
        rows: csr_matrix,
        anchors: Anchors,
        timeline: Timeline,
        place: np.ndarray,
        velocity: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Positions [m] and velocities [m/s] of the markers, (T, M, 3), by those of anchors and of holds.

        rows: (M, n) weights of the anchors; place, velocity: (F + 1, n, 3) of these at the start and at the
        moving frames. Raises SimulationError where a position is not finite.
        """
        a = self.attachment
        rest = a.anchor + a.offset
        position = np.repeat(rest[None], len(timeline.frames), axis=0)
        speed = np.zeros_like(position)
        for k, frame in enumerate(range(len(timeline.frames))[timeline.shown]):
            position[frame] += rows @ (place[k + timeline.skipped] - anchors.rest)
            speed[frame] = rows @ velocity[k + timeline.skipped]
        held = a.hold >= 0
        now, later, before = (
            carried_points(self.recording, timeline.clock + tick, rest[held], a.hold[held])
            for tick in (0.0, _TICK, -_TICK)
        )
        position[:, held], speed[:, held] = now, (later - before) / (2.0 * _TICK)
        if not np.isfinite(position).all():
            raise SimulationError("the motion is not finite")
        return position, speed

    def acting(self, timeline: Timeline) -> Iterator[tuple[Load, np.ndarray]]:
        """Known loads, each with the share of every interval in which it acts, (F,)."""
        fps = self.recording.fps
        for load in self.recording.loads:
            edges = (load.start_frame, np.inf if load.end_frame is None else load.end_frame)
            since = [np.clip((timeline.times - edge / fps) / timeline.spans, 0.0, 1.0) for edge in edges]
            yield load, since[0] - since[1]

    def mass(self, belief: Belief) -> float:
        """Of the object [kg], as known or as a belief has it."""
        if belief.known_mass is not None:
            return belief.known_mass
        return sum(part_mass(belief, part) for part in self.capture.parts)

    def slopes(self, belief: Belief, last: int, keys: Sequence[str], like: np.ndarray) -> np.ndarray:
        """(T, M, 3, K) derivative of the positions by the coordinates of `keys`. like: (T, M, 3)."""
        return np.zeros((*like.shape, len(keys)))

    def predict(
        self,
        belief: Belief,
        *,
        last: int | None = None,
        keys: Sequence[str] = (),
        candidates: Sequence[Owned] = (),
        substep: float | None = None,
        start: Start | None = None,
        feedback: Feedback | None = None,
        progress: Callable[[int], bool] | None = None,
    ) -> Prediction:
        """As `Predictor.predict`; steps are the model's own. Raises ValueError for candidates, a start in
        mid-motion or feedback."""
        if candidates or start is not None or (feedback is not None and feedback.gain > 0.0):
            raise ValueError("a baseline: expected a free run from the sequence's own start")
        last = self.recording.frames if last is None else last
        known = self._known(belief, last, None, tuple(keys), None)
        if known is not None:
            return known
        timeline, position, velocity = self.moved(belief, last)
        jacobian = self.slopes(belief, last, keys, position)
        prediction = Prediction(
            timeline.frames, position, velocity, jacobian, tuple(keys), timeline.substeps, timeline.longest
        )
        kept = self._kept if keys else self._plain
        kept[:] = [*kept[-2:], (belief, last, None, None, prediction)]
        return prediction


def start_of(
    predictor: Predictor, belief: Belief, points: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Places [m] and velocities [m/s] of material points (K, 3) [m] when a sequence's motion begins."""
    start = predictor.start(belief)
    if start is None:
        return points.copy(), np.zeros_like(points)
    attached = replace(predictor.body.attach(points), hold=np.full(len(points), -1))
    rows = predictor.transfer.carriers(attached)
    moved = np.einsum("mk,mkc->mc", rows.value, start.displacement[rows.index])
    return points + moved, np.einsum("mk,mkc->mc", rows.value, start.velocity[rows.index])
