"""Following Gaussians through videos, frame by frame, in the manner of Dynamic 3D Gaussians.

Gaussians of fixed size and colour move and turn so that they explain the pictures (Luiten et al. 2024). What
moves here are control points that carry the Gaussians, by Gauss and Newton, from where their velocity leads.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from mphygs.capture.rotation import align_rigid, rotation_vector_from_matrix
from mphygs.capture.views import Photograph
from mphygs.motion.alignment import Aligner, Alignment, AlignmentRule
from mphygs.motion.control_graph import ControlGraph, Pose, control_graph
from mphygs.scene.gaussians import Gaussians

# Share of trust (see sight.py) from which a picture counts as showing a Gaussian and nothing else.
_TRUSTED = 0.3
# Times the usual difference between drawings and photographs, from which a frame is tried again.
_UNUSUAL = 1.5
_REMEMBERED = 0.5  # of the velocity of control points against the whole
_SEED_OPACITY = 0.3  # of Gaussians that may become control points
_PER_CONTROL_POINT = 6  # fewest Gaussians


@dataclass(frozen=True)
class TrackingRule:
    """control_points: how many carry the Gaussians; alignment: with the pictures of each frame; wide: levels
    for a frame that did not succeed."""

    control_points: int = 250
    alignment: AlignmentRule = field(default_factory=AlignmentRule)
    wide: tuple[tuple[int, int], ...] = ((16, 6), (8, 6), (4, 5), (2, 4), (1, 4))

    def __post_init__(self) -> None:
        if self.control_points < 5:
            raise ValueError(f"control_points: {self.control_points}; expected at least 5")


@dataclass(frozen=True, eq=False)
class Followed:
    """The first t frames. position: (t, J, 3) [m] and rotation: (t, J, 3, 3) of the control points; cameras:
    (t, N), how many show each of the Gaussians that are compared; difference: (t,), root mean square of
    colours and silhouettes, drawn and seen."""

    position: np.ndarray
    rotation: np.ndarray
    cameras: np.ndarray
    difference: np.ndarray

    @classmethod
    def nothing(cls, graph: ControlGraph, compared: int) -> Followed:
        """No frame yet."""
        count = len(graph.nodes)
        return cls(np.zeros((0, count, 3)), np.zeros((0, count, 3, 3)), np.zeros((0, compared)), np.zeros(0))

    @property
    def frames(self) -> int:
        """How many are done."""
        return len(self.position)

    def pose(self, frame: int) -> Pose:
        """Of the control points."""
        return Pose(self.position[frame], self.rotation[frame])

    def expected(self, frame: int) -> Pose:
        """The pose of a frame from 1 on, by the velocity of the two before it.

        The rigid motion of the whole goes on; of what is left to each control point half does, for where
        pictures say little its errors would grow from frame to frame.
        """
        last = self.pose(frame - 1)
        if frame == 1:
            return last
        before = self.pose(frame - 2)
        rotation, shift = align_rigid(before.position, last.position)
        carried = before.turned(rotation, shift)
        left = rotation_vector_from_matrix(np.einsum("jab,jcb->jac", last.rotation, carried.rotation))
        step = _REMEMBERED * np.concatenate([left, last.position - carried.position], axis=1)
        return last.moved(step).turned(rotation, shift)

    def after(self, alignment: Alignment) -> Followed:
        """One frame more."""
        shown = np.sum([s.visible & (s.trust > _TRUSTED) for s in alignment.sights], axis=0)
        added = (alignment.pose.position, alignment.pose.rotation, shown, alignment.difference)
        mine = (self.position, self.rotation, self.cameras, self.difference)
        pairs = zip(mine, added, strict=True)
        return Followed(*(np.concatenate([have, np.asarray(new)[None]]) for have, new in pairs))


def aligner_of(gaussians: Gaussians, rule: TrackingRule) -> Aligner:
    """Control points on the Gaussians, as many as the rule says where there are Gaussians enough."""
    points = gaussians.positions.detach().numpy().astype(np.float64)
    seeds = gaussians.opacities.detach().numpy() > _SEED_OPACITY
    count = min(rule.control_points, max(int(seeds.sum()) // _PER_CONTROL_POINT, 5))
    return Aligner(gaussians, control_graph(points, count=count, seeds=seeds), rule.alignment)


def follow(
    aligner: Aligner,
    read: Callable[[int], Sequence[Photograph]],
    frames: int,
    first: Pose,
    *,
    rule: TrackingRule,
    done: Followed | None = None,
    report: Callable[[Followed], object] | None = None,
) -> Followed:
    """All frames, or those that are left where some are `done`.

    read: frame -> the pictures of all cameras; first: expected pose of frame 0; report: is called after every
    frame with what is done. The same numbers whether broken off or not.
    """
    followed = done or Followed.nothing(aligner.graph, len(aligner.chosen))
    while followed.frames < frames:
        frame = followed.frames
        expected = followed.expected(frame) if frame else first
        photographs = read(frame)
        best = aligner.align(photographs, expected)
        if frame and best.difference > _UNUSUAL * float(np.median(followed.difference)):
            # a jerk: from where it was, and from where it should be, with more patience
            for start in (expected, followed.pose(frame - 1)):
                other = aligner.align(photographs, start, levels=rule.wide)
                if other.difference < best.difference:
                    best = other
        followed = followed.after(best)
        if report is not None:
            report(followed)
    return followed
