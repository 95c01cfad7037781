"""What instruments beside the markers read of a run, with its tangent and its adjoint.

As markers are (`mphygs.simulate.marker_carriers`), an instrument is a map from the states of a run to numbers
by frame, (T, V, 3): V vectors of one unit each. What it reads beyond the states, the weight of what a hold
carries or the gravity that an accelerometer feels, depends on the belief alone.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from mphygs.capture.record import Sequence as Recording
from mphygs.capture.sensors import FORCE, Sensor
from mphygs.model.belief import Belief, Parameter
from mphygs.simulate.body import Body
from mphygs.simulate.fields import gravity_of
from mphygs.simulate.held_material import HeldMaterial
from mphygs.simulate.marker_carriers import Carriers
from mphygs.simulate.timeline import Timeline
from mphygs.simulate.transfer import Transfer

# Of a parameter's usual size: what an instrument reads beyond the states is smooth in every one.
STEP = 1e-4
# Bars of the displacement and velocity of the carriers, (S, N, 3), and of the reactions, (S, H, 6) or none.
Bars = tuple[np.ndarray | None, np.ndarray | None, np.ndarray | None]


@dataclass(frozen=True, eq=False)
class Reading:
    """What an instrument reads of a model. value: (T, V, 3); jacobian: (T, V, 3, K)."""

    value: np.ndarray
    jacobian: np.ndarray

    def with_columns(self, columns: Sequence[int], count: int) -> Reading:
        """The same by `count` coordinates, of which these are its own."""
        jacobian = np.zeros((*self.value.shape, count))
        jacobian[..., columns] = self.jacobian
        return Reading(self.value, jacobian)


class Instrument(ABC):
    """One instrument of a sequence."""

    @abstractmethod
    def observe(self, states: tuple, timeline: Timeline) -> np.ndarray:
        """(T, V, 3) what it reads of the states."""

    @abstractmethod
    def observe_tangent(self, change: tuple, timeline: Timeline) -> np.ndarray:
        """Derivative of `observe`, (T, V, 3), for one of the states: it is linear in them."""

    @abstractmethod
    def observe_adjoint(self, timeline: Timeline, bar: np.ndarray, count: int) -> Bars:
        """Bars of the states for the bar (T, V, 3) of what is read. count: of the carriers."""

    @abstractmethod
    def direct(self, belief: Belief, timeline: Timeline) -> np.ndarray:
        """(T, V, 3) what it reads beyond the states."""

    def read(self, belief: Belief, states: tuple, timeline: Timeline) -> np.ndarray:
        """(T, V, 3) all that it reads."""
        return self.observe(states, timeline) + self.direct(belief, timeline)

    def direct_slope(self, owner: Belief, parameter: Parameter, timeline: Timeline) -> np.ndarray:
        """Derivative of `direct` by the coordinate of one of a belief's parameters."""
        step = STEP * (min(parameter.scale, parameter.value) if parameter.log else parameter.scale)
        wide = {"lower": 0.5 * parameter.value if parameter.log else -np.inf, "upper": np.inf}
        ahead, behind = (
            self.direct(owner.with_parameter(parameter.key, value=parameter.value + d, **wide), timeline)
            for d in (step, -step)
        )
        return (ahead - behind) / (2.0 * step) * parameter.slope


@dataclass(frozen=True, eq=False)
class HoldForce(Instrument):
    """Force and torque that a hold exerts on the object, all that it holds of it included.

    The torque is about the centre of its box, carried by the hold. hold: its number; vectors: 1 or 2, with
    the torque; hold_count: of the sequence.
    """

    held: HeldMaterial
    hold: int
    vectors: int
    hold_count: int

    def observe(self, states: tuple, timeline: Timeline) -> np.ndarray:
        return self._of(states[-1], timeline)

    def observe_tangent(self, change: tuple, timeline: Timeline) -> np.ndarray:
        return self._of(change[-1], timeline)

    def _of(self, reaction: np.ndarray, timeline: Timeline) -> np.ndarray:
        shown = np.asarray(reaction, float)[timeline.skipped :, self.hold, : 3 * self.vectors]
        # What bears the object before its release is not told: as at the first state.
        index = np.maximum(np.arange(len(timeline.frames)) - timeline.resting, 0)
        if not len(shown):
            return np.zeros((len(timeline.frames), self.vectors, 3))
        return shown[index].reshape(len(index), self.vectors, 3)

    def observe_adjoint(self, timeline: Timeline, bar: np.ndarray, count: int) -> Bars:
        out = np.zeros((len(timeline.moving) + 1, self.hold_count, 6))
        if len(timeline.moving) + 1 > timeline.skipped:
            shown = out[timeline.skipped :, self.hold, : 3 * self.vectors]
            flat = bar.reshape(len(bar), -1)
            shown += flat[timeline.resting :]
            shown[0] += flat[: timeline.resting].sum(0)
        return None, None, out

    def direct(self, belief: Belief, timeline: Timeline) -> np.ndarray:
        return self.held.wrench(belief, timeline.clock)[:, : self.vectors]


@dataclass(frozen=True, eq=False)
class PointAcceleration(Instrument):
    """Acceleration of a material point along the axes of the sequence, less gravity where that is included.

    From places x and velocities v of three frames in a row, exact for polynomials of degree 5:
    a_k = 2 (x_k+1 - 2 x_k + x_k-1) / h^2 - (v_k+1 - v_k-1) / 2h (Collatz, "The numerical treatment of
    differential equations", 1960, table III).
    """

    carriers: Carriers
    recording: Recording
    gravity: bool
    body: Body

    def observe(self, states: tuple, timeline: Timeline) -> np.ndarray:
        return self._of(*self.carriers.observe(states, timeline, self.recording))

    def observe_tangent(self, change: tuple, timeline: Timeline) -> np.ndarray:
        place, velocity = (
            self.carriers.observe_tangent((field,), (field,), timeline) for field in change[:2]
        )
        return self._of(place, velocity)

    def _of(self, place: np.ndarray, velocity: np.ndarray) -> np.ndarray:
        """(T, 1, 3) of places [m] and velocities [m/s]; in the first and last frame the cubic's."""
        h = 1.0 / self.recording.fps
        out = np.zeros_like(place)
        if len(place) > 2:
            second = place[2:] - 2.0 * place[1:-1] + place[:-2]
            out[1:-1] = 2.0 * second / h**2 - (velocity[2:] - velocity[:-2]) / (2.0 * h)
        if len(place) > 1:
            for end, near, sign in ((0, 1, 1.0), (-1, -2, -1.0)):
                out[end] = 6.0 * (place[near] - place[end]) / h**2
                out[end] -= sign * (4.0 * velocity[end] + 2.0 * velocity[near]) / h
        return out

    def observe_adjoint(self, timeline: Timeline, bar: np.ndarray, count: int) -> Bars:
        h = 1.0 / self.recording.fps
        place, velocity = np.zeros_like(bar), np.zeros_like(bar)
        if len(bar) > 2:
            inner = bar[1:-1]
            for shift, weight, sign in ((2, 1.0, 1.0), (1, -2.0, 0.0), (0, 1.0, -1.0)):
                at = slice(shift, len(bar) - 2 + shift)
                place[at] += 2.0 * weight * inner / h**2
                velocity[at] -= sign * inner / (2.0 * h)
        if len(bar) > 1:
            for end, near, sign in ((0, 1, 1.0), (-1, -2, -1.0)):
                place[near] += 6.0 * bar[end] / h**2
                place[end] -= 6.0 * bar[end] / h**2
                velocity[end] -= 4.0 * sign * bar[end] / h
                velocity[near] -= 2.0 * sign * bar[end] / h
        return *self.carriers.observe_adjoint(None, timeline, place, velocity, count), None

    def direct(self, belief: Belief, timeline: Timeline) -> np.ndarray:
        out = np.zeros((len(timeline.frames), 1, 3))
        return out - gravity_of(belief, self.body) if self.gravity else out


def check_force_sensors(recording: Recording, pulled: Collection[int]) -> None:
    """Raises ValueError where a force is read at one of the holds that tendons pull at: what a hold gives to
    bear them is not told."""
    for number, sensor in enumerate(recording.sensors):
        if sensor.kind == FORCE and sensor.hold in pulled:
            raise ValueError(
                f"sequence '{recording.name}', sensors[{number}]: a tendon passes hold {sensor.hold}; "
                "expected another hold, for the force of such a one is not told"
            )


def instrument_of(sensor: Sensor, transfer: Transfer, recording: Recording) -> Instrument:
    """The instrument that a sensor of a sequence is, on what a transfer simulates.

    An accelerometer off the object is read at the point of it that is nearest.
    """
    body = transfer.body
    if sensor.kind == FORCE:
        held = HeldMaterial.of(body, sensor.hold, recording.held[sensor.hold], recording.fps)
        return HoldForce(held, sensor.hold, sensor.value.shape[1], len(recording.held))
    attachment = body.attach(np.asarray(sensor.at, float)[None])
    attachment = replace(attachment, offset=np.zeros_like(attachment.offset))
    return PointAcceleration(transfer.carriers(attachment), recording, sensor.gravity, body)


def compared_frames(recording: Recording, sensor: Sensor) -> np.ndarray:
    """(T,) bool of the frames in which a model says what a sensor reads.

    Not the first and the last one, which have frames on one side alone; nor, of a force, those before the
    release, when more than the holds bears the object; nor those in which the release itself may fall.
    """
    frames = np.arange(recording.frames)
    told = (frames > 0) & (frames < recording.frames - 1)
    if recording.release is not None:
        near = np.abs(frames - recording.release) < 2
        told &= ~near
        if sensor.kind == FORCE:
            told &= frames > recording.release
    return told
