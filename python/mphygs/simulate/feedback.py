"""Feedback from the measurement: what pulls a simulation towards where its markers were seen.

Every carrier (node or particle) n gets the acceleration

    sum_i G_ni [ omega^2 e_i + 2 zeta omega de_i/dt ],   e_i = y_i(t) - h_i(u(t)),

y_i the measured place of marker i between frames (cubic spline), h_i the marker as the simulation has it, G
how pulls are spread (`mphygs.simulate.pull_distribution`). What the model lacks then shows at once and does
not pile up. Sources: Luenberger, "Observing the state of a linear system", 1964; Hoke & Anthes, "The
initialization of numerical models by a dynamic-initialization technique", 1976; prediction errors after
Ljung, "System identification", ch. 7.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.sparse import bsr_matrix, csr_matrix

from mphygs.capture.record import Sequence as Recording
from mphygs.model.belief import Belief, Parameter
from mphygs.simulate.marker_carriers import Carriers
from mphygs.simulate.measurement import lateness, without_measurement_faults
from mphygs.simulate.observer import Observer
from mphygs.simulate.timeline import Timeline
from mphygs.simulate.transfer import Transfer

# Critically damped, with a memory of 2 / fps: faster, and the noise of single frames is followed; slower, and
# what is missing piles up.
DAMPING_RATIO, PER_FRAME = 1.0, 0.5
# Of a fault's usual size, the step of differences by it: what faults make of the targets is nearly linear.
STEP = 1e-3


@dataclass(frozen=True, eq=False)
class Feedback:
    """What pulls one sequence's simulation.

    gain: 0 (none) to 1 (a memory of 2 / fps), it scales the acceleration; position: (T, M, 3) measured [m],
    NaN where it is not; rest: (M, 3) markers at rest [m]; free: (M,) markers that the material carries and
    that were seen; rows: sparse (channels, carriers); reach: sparse (carriers, channels), or in blocks; row:
    (carriers,) which row of reach each has, -1 for none, where several have one.
    """

    recording: Recording
    gain: float
    position: np.ndarray
    rest: np.ndarray
    free: np.ndarray
    rows: csr_matrix = field(repr=False)
    reach: csr_matrix | bsr_matrix = field(repr=False)
    row: np.ndarray | None = field(repr=False, default=None)
    _last: dict = field(repr=False, default_factory=dict)

    def __post_init__(self) -> None:
        if not 0.0 <= self.gain <= 1.0:
            raise ValueError(f"feedback {self.gain:g}: expected a gain from 0 (none) to 1")

    @classmethod
    def of(
        cls,
        recording: Recording,
        carriers: Carriers,
        transfer: Transfer,
        position: np.ndarray,
        *,
        gain: float = 1.0,
    ) -> Feedback:
        """Feedback of a recording. transfer: whose carriers are pulled; position: (T, M, 3) [m], NaN where a
        marker was not seen or is left out.

        Raises ValueError where the gain is not between 0 and 1.
        """
        a = carriers.attachment
        rest = a.anchor + a.offset
        seen = np.isfinite(position).all(-1).sum(0) >= 4
        own = seen[carriers.free]
        free = np.zeros(len(rest), bool)
        free[np.flatnonzero(carriers.free)[own]] = True
        index, value = carriers.index[own], carriers.value[own].copy()
        turning = carriers.turning[own]
        offset = a.offset[free][turning]
        # Standing off the material a marker follows its gradient: F offset, and not R offset, is linear.
        value[turning] += np.einsum("mkj,mj->mk", carriers.gradient[own][turning], offset)
        count = len(index)
        begin = np.repeat(np.arange(count), index.shape[1])
        shape = (count, len(transfer.places_at_rest()))
        rows = csr_matrix((value.ravel(), (begin, index.ravel())), shape=shape)
        return cls(recording, gain, position, rest, free, rows, *transfer.spread(rows, rest[free]))

    def scaled(self, gain: float) -> Feedback:
        """The same with another gain."""
        return self if gain == self.gain else replace(self, gain=gain)

    @property
    def omega(self) -> float:
        """Natural frequency of what is missing under full gain [rad/s]."""
        return PER_FRAME * self.recording.fps

    def observer(self, timeline: Timeline) -> Observer:
        """What the core takes, for the intervals of a timeline."""
        rows, reach = self.rows, self.reach
        full = Observer(
            row_begin=rows.indptr.astype(np.int32),
            row_carrier=rows.indices.astype(np.int32),
            row_weight=rows.data,
            reach_begin=reach.indptr.astype(np.int32),
            reach_channel=reach.indices.astype(np.int32),
            reach_weight=reach.data.ravel(),
            stiffness=self.omega**2,
            damping=2.0 * DAMPING_RATIO * self.omega,
            share=self._share(timeline),
            reach_row=np.asarray([] if self.row is None else self.row, np.int32),
        )
        return full.scaled(self.gain)

    def _share(self, timeline: Timeline) -> np.ndarray:
        """(F, channels) 1 where the frames to both sides of an interval's middle show the marker."""
        seen = np.isfinite(self.position[:, self.free]).all(-1)
        last = len(seen) - 1
        after = np.clip(timeline.moving, 0, last)
        return (seen[np.clip(after - 1, 0, last)] & seen[after]).astype(float)

    def target(self, belief: Belief, timeline: Timeline) -> np.ndarray:
        """(F, channels, 4, 3) where the markers are wanted, as displacements [m]: cubic polynomials in the
        share of each interval; faults of the measurement that the belief has are taken off."""
        asked = self._asked(belief, timeline)
        known = self._last.get("asked", (np.empty(0),) * len(asked))
        if not all(np.array_equal(a, b, equal_nan=True) for a, b in zip(known, asked, strict=True)):
            self._last.update(asked=asked, target=self._splines(*asked))
        return self._last["target"]

    def _asked(self, belief: Belief, timeline: Timeline) -> tuple[np.ndarray, ...]:
        """What `_splines` takes."""
        position = without_measurement_faults(
            belief, np.arange(len(self.position)) / self.recording.fps, self.position
        )
        late = timeline.clock[0] - timeline.frames[0] / self.recording.fps if len(timeline.clock) else 0.0
        return position, np.asarray(late), timeline.times, timeline.spans

    def _splines(
        self, position: np.ndarray, late: np.ndarray, times: np.ndarray, spans: np.ndarray
    ) -> np.ndarray:
        """`target` of markers (T, M, 3) [m] in frames that were taken `late` [s], for intervals (F,) that end
        at `times` and last `spans` [s]."""
        clock = np.arange(len(position)) / self.recording.fps + late
        begin = times - spans
        out = np.zeros((len(begin), int(self.free.sum()), 4, 3))
        if not len(begin):
            return out
        displaced = position[:, self.free] - self.rest[self.free]
        seen = np.isfinite(displaced).all(-1)
        lasting = spans[:, None, None]
        patterns, kind = np.unique(seen, axis=1, return_inverse=True)
        for k, pattern in enumerate(patterns.T):
            own = np.flatnonzero(kind.ravel() == k)
            spline = CubicSpline(clock[pattern], displaced[pattern][:, own])
            start, end = clock[pattern][0], clock[pattern][-1]
            a, b = np.clip(begin, start, end), np.clip(times, start, end)
            p0, p1 = spline(a), spline(b)
            m0, m1 = spline(a, 1) * lasting, spline(b, 1) * lasting
            pieces = (p0, m0, 3.0 * (p1 - p0) - 2.0 * m0 - m1, 2.0 * (p0 - p1) + m0 + m1)
            out[:, own] = np.stack(pieces, axis=2)
        return out

    def change(self, belief: Belief, parameter: Parameter, timeline: Timeline) -> np.ndarray:
        """Derivative of `target` by the coordinate of a fault's parameter."""
        step = STEP * parameter.scale
        wide = {"lower": -np.inf, "upper": np.inf}
        ends = [
            belief.with_parameter(parameter.key, value=parameter.value + sign * step, **wide)
            for sign in (1.0, -1.0)
        ]
        moved = (self._asked(b, _at_clock_of(b, timeline, self.recording.fps)) for b in ends)
        ahead, behind = (self._splines(*asked) for asked in moved)
        return (ahead - behind) / (2.0 * step) * parameter.slope


def _at_clock_of(belief: Belief, timeline: Timeline, fps: float) -> Timeline:
    """The timeline with its frames taken when a belief says, its intervals where they are."""
    return replace(timeline, clock=timeline.frames / fps + lateness(belief))
