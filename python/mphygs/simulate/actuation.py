"""Forces, pressures and tendons that are given frame by frame, as the core takes them.

They act at points that the material or a hold carries (see cpp/include/mphygs/physics/actuation.hpp). Their
numbers are the core's channels: gain * values(t - delay) of every actuator, as cubic polynomials in the
share of each output interval that have its value and its rate at both ends.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from mphygs.capture.actuators import Actuator, Force, Pressure, Tendon
from mphygs.capture.record import Sequence as Recording
from mphygs.model.belief import Belief, Parameter
from mphygs.model.registry import effects
from mphygs.scene.patch import surface_patch
from mphygs.simulate.timeline import Timeline
from mphygs.simulate.transfer import Transfer

GAIN, DELAY = "gain", "delay"
_NONE = np.empty((0, 3), np.int64)


@dataclass(eq=False)
class _Points:
    """What the core is told of the points, while they are collected."""

    begin: list[int] = field(default_factory=lambda: [0])
    carrier: list[np.ndarray] = field(default_factory=list)
    weight: list[np.ndarray] = field(default_factory=list)
    place: list[np.ndarray] = field(default_factory=list)
    hold: list[int] = field(default_factory=list)

    def add(self, place: np.ndarray, carrier: np.ndarray, weight: np.ndarray, hold: int = -1) -> int:
        self.begin.append(self.begin[-1] + len(carrier))
        self.carrier.append(carrier)
        self.weight.append(weight)
        self.place.append(np.asarray(place, float))
        self.hold.append(hold)
        return len(self.hold) - 1

    def still(self, place: np.ndarray, hold: int = -1) -> int:
        """A point of no carriers: one of a hold, or one that stands in space."""
        return self.add(place, np.empty(0, np.int32), np.empty(0), hold)


class Actuation:
    """The actuators of one sequence on one discretised object."""

    def __init__(self, recording: Recording, transfer: Transfer) -> None:
        """Raises ValueError where a patch has no free surface."""
        self._recording = recording
        self._actuators = recording.actuators
        sizes = [1 if a.values.ndim == 1 else a.values.shape[1] for a in self._actuators]
        self._first = np.concatenate([[0], np.cumsum(sizes)])
        self.core = self._placed(transfer) if self._actuators else None

    @property
    def channel_count(self) -> int:
        """Number of the core's channels."""
        return int(self._first[-1])

    @property
    def held(self) -> frozenset[int]:
        """The holds that tendons pull at: the core takes that as borne, and tells no reaction to it."""
        return frozenset(h for h in (self.core or {}).get("hold", ()) if h >= 0)

    def _placed(self, transfer: Transfer) -> dict[str, object]:
        """Where they act, as the core takes it."""
        points = _Points()
        force_point, force_channel = [], []
        path_begin, path_point, path_channel = [0], [], []
        triangles, middles, triangle_channel = [_NONE], [_NONE], []
        for actuator, channel in zip(self._actuators, self._first, strict=False):
            if isinstance(actuator, Force):
                share = transfer.load_share(actuator)
                used = np.flatnonzero(share)
                force_point.append(points.add(actuator.box.mean(0), used, share[used]))
                force_channel.append(channel)
            elif isinstance(actuator, Tendon):
                path_point += _path(actuator, points, transfer)
                path_begin.append(len(path_point))
                path_channel.append(channel)
            elif isinstance(actuator, Pressure):
                corner, middle = _triangles(actuator, points, transfer, self._recording.name)
                triangles.append(corner)
                middles.append(middle)
                triangle_channel += [channel] * len(corner)
        numbers = {
            "row_begin": points.begin,
            "row_carrier": np.concatenate(points.carrier),
            "hold": points.hold,
            "force_point": force_point,
            "force_channel": force_channel,
            "path_begin": path_begin,
            "path_point": path_point,
            "path_channel": path_channel,
            "triangle": np.concatenate(triangles),
            "triangle_middle": np.concatenate(middles),
            "triangle_channel": triangle_channel,
        }
        return {name: np.asarray(value, np.int32) for name, value in numbers.items()} | {
            "row_weight": np.concatenate(points.weight),
            "place": np.array(points.place),
            "channel_count": self.channel_count,
        }

    def channels(self, belief: Belief, timeline: Timeline) -> np.ndarray:
        """(F, C, 4) polynomials of a belief in the intervals of a timeline [N or Pa]."""
        return np.concatenate([self._course(a, belief, timeline) for a in self._actuators], axis=1)

    def change(self, belief: Belief, parameter: Parameter, timeline: Timeline) -> np.ndarray | None:
        """Their derivative by a parameter's coordinate; None where it is none of theirs."""
        if all(parameter.key != f"{a.name}.{q}" for a in self._actuators for q in (GAIN, DELAY)):
            return None
        return np.concatenate([self._course(a, belief, timeline, parameter) for a in self._actuators], axis=1)

    def _course(
        self, actuator: Actuator, belief: Belief, timeline: Timeline, by: Parameter | None = None
    ) -> np.ndarray:
        """(F, c, 4) of one of them, or its derivative by one of the belief's parameters."""
        gain, delay = _numbers(belief, actuator)
        name, _, quantity = (by.key if by is not None else f"{actuator.name}.").rpartition(".")
        factor, order = gain, 0
        if by is not None:
            factor = 0.0 if name != actuator.name else by.slope if quantity == GAIN else -gain * by.slope
            order = 1 if quantity == DELAY else 0
        fps, spans = self._recording.fps, timeline.spans
        edges = [actuator.start_frame, np.inf if actuator.end_frame is None else actuator.end_frame]
        # Of the interval in which it starts or ends it has the impulse.
        since = [np.clip((timeline.times - edge / fps) / spans, 0.0, 1.0) for edge in edges]
        acting = (factor * (since[0] - since[1]))[:, None]

        def at(times: np.ndarray, derivative: int) -> np.ndarray:
            return acting * actuator.course(times - delay, fps, derivative).reshape(len(times), -1)

        ends = (timeline.times - spans, timeline.times)
        (p0, p1), (m0, m1) = (
            [at(end, order) for end in ends],
            [at(end, order + 1) * spans[:, None] for end in ends],
        )
        return np.stack([p0, m0, 3.0 * (p1 - p0) - 2.0 * m0 - m1, 2.0 * (p0 - p1) + m0 + m1], axis=2)

    def largest(self, belief: Belief) -> np.ndarray:
        """(1, C, 4) that stand at the largest size of every channel, for the stable substep."""
        found = np.zeros((1, self.channel_count, 4))
        most = [
            _numbers(belief, a)[0] * np.abs(a.values.reshape(len(a.values), -1)).max(0)
            for a in self._actuators
        ]
        found[0, :, 0] = np.concatenate(most)
        return found


def acts_by_channels(parameter: Parameter) -> bool:
    """Whether a parameter is the gain or the delay of some sequence's actuator."""
    name, _, quantity = parameter.key.rpartition(".")
    return quantity in (GAIN, DELAY) and name not in effects()


def _numbers(belief: Belief, actuator: Actuator) -> tuple[float, float]:
    """Gain [-] and delay [s] that a belief has an actuator act with."""
    usual = {GAIN: 1.0, DELAY: 0.0}
    keys = {quantity: f"{actuator.name}.{quantity}" for quantity in usual}
    gain, delay = (belief[k].value if (k := keys[q]) in belief else usual[q] for q in usual)
    return gain, delay


def _path(actuator: Tendon, points: _Points, transfer: Transfer) -> list[int]:
    attachment = transfer.body.attach(actuator.path)
    carrier, weight = transfer.point_rows(attachment.anchor, attachment.part)
    found = [
        points.still(place, hold) if hold >= 0 else points.add(place, carrier[k], weight[k])
        for k, (place, hold) in enumerate(zip(actuator.path, attachment.hold, strict=True))
    ]
    return found if actuator.anchor is None else [*found, points.still(actuator.anchor)]


def _triangles(
    actuator: Pressure, points: _Points, transfer: Transfer, sequence: str
) -> tuple[np.ndarray, np.ndarray]:
    """Points (Q, 3) at the corners of a patch's triangles, and amidst their sides."""
    body = transfer.body
    patch = surface_patch(
        body.parts,
        max_edge=transfer.settings.spacing,
        part=actuator.part,
        box=actuator.box,
        exclude_boxes=body.boxes if len(body.boxes) else None,
    )
    if not len(patch.triangles):
        raise ValueError(
            f"sequence '{sequence}', load '{actuator.name}': its patch has no surface that is open and not "
            "held; expected some"
        )
    sides = patch.triangles[:, [[0, 1], [1, 2], [2, 0]]]
    ends, side = np.unique(np.sort(sides.reshape(-1, 2), axis=1), axis=0, return_inverse=True)
    at = np.concatenate([patch.vertices, patch.vertices[ends].mean(axis=1)])
    carrier, weight = transfer.point_rows(at, np.concatenate([patch.part, patch.part[ends[:, 0]]]))
    index = np.array([points.add(place, carrier[k], weight[k]) for k, place in enumerate(at)])
    count = len(patch.vertices)
    return index[:count][patch.triangles], index[count:][side.reshape(-1, 3)]
