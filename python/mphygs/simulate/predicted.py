"""What a model says of a sequence: its markers, what its instruments read, and their derivatives."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from mphygs.model.belief import Belief
from mphygs.simulate.batches import Owned
from mphygs.simulate.instruments import Instrument, Reading
from mphygs.simulate.timeline import Timeline


@dataclass(frozen=True, eq=False)
class Prediction:
    """What a model says of a sequence's markers and of what its instruments read.

    frames: (T,) frame indices; position: (T, M, 3) [m]; velocity: (T, M, 3) [m/s];
    jacobian: (T, M, 3, K) by the coordinates of `keys`; substeps: number computed; readings: of every sensor.
    """

    frames: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    jacobian: np.ndarray
    keys: tuple[str, ...]
    substeps: int
    dt: float
    readings: tuple[Reading, ...] = ()

    def until(self, last: int) -> Prediction:
        """The prediction of its frames before `last`."""
        count = int(np.searchsorted(self.frames, last))
        readings = tuple(Reading(r.value[:count], r.jacobian[:count]) for r in self.readings)
        cut = (self.frames[:count], self.position[:count], self.velocity[:count], self.jacobian[:count])
        return Prediction(*cut, self.keys, self.substeps, self.dt, readings)

    def without_slopes(self) -> Prediction:
        """The prediction alone."""
        readings = tuple(Reading(r.value, r.jacobian[..., :0]) for r in self.readings)
        return replace(self, jacobian=self.jacobian[..., :0], keys=(), readings=readings)


@dataclass(frozen=True, eq=False)
class Started:
    """A run that starts a little later: markers (T, M, 3) [m], readings (T, V, 3), and the slope of a
    coordinate over what the start was moved by."""

    position: np.ndarray
    readings: tuple[np.ndarray, ...]
    slope: float


def readings_of(
    instruments: Sequence[Instrument],
    belief: Belief,
    states: tuple,
    timeline: Timeline,
    wanted: Sequence[Owned],
    tangents: Mapping[int, tuple],
) -> tuple[Reading, ...]:
    """What instruments read of a run, and its derivative by the wanted parameters.

    tangents: of the states, by the parameters' places among the wanted ones.
    """
    found = []
    for instrument in instruments:
        value = instrument.read(belief, states, timeline)
        jacobian = np.zeros((*value.shape, len(wanted)))
        for slot, (owner, parameter) in enumerate(wanted):
            if slot in tangents:
                jacobian[..., slot] = instrument.observe_tangent(tangents[slot], timeline)
                jacobian[..., slot] += instrument.direct_slope(owner, parameter, timeline)
            elif parameter.key == "time_offset.offset" and len(value) > 1:
                # A later clock shows what comes next.
                jacobian[..., slot] = np.gradient(value, timeline.clock, axis=0) * parameter.slope
        found.append(Reading(value, jacobian))
    return tuple(found)
