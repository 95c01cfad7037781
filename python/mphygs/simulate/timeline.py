"""Frames and substeps of one run."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mphygs.capture.record import Sequence as Recording
from mphygs.simulate.errors import SimulationError

# In one run: more take hours.
MOST_SUBSTEPS = 1e7
# Of a pair of implicit substeps, what the first takes: cpp/include/mphygs/total_lagrangian/substep_rule.hpp.
FIRST_OF_PAIR = 2.0 - np.sqrt(2.0)


@dataclass(frozen=True, eq=False)
class Timeline:
    """Output frames and substeps of a run.

    frames: (T,) frames to show; clock: (T,) when they were taken [s]; moving: those after the initial state,
    computed one by one; times: of these [s]; resting: frames that show the object at rest, before the run's
    own states; skipped: states of the run before the first one that a frame shows.
    """

    frames: np.ndarray
    clock: np.ndarray
    moving: np.ndarray
    schedule: dict
    times: np.ndarray
    resting: int
    skipped: int

    @property
    def shown(self) -> slice:
        """Where the run's states stand among the frames."""
        return slice(self.resting, len(self.frames))

    @property
    def spans(self) -> np.ndarray:
        """(F,) length of the intervals that end at the moving frames [s]."""
        return self.schedule["dt"] * self.schedule["steps"]

    @property
    def substeps(self) -> int:
        """Number of substeps of all frames."""
        return int(self.schedule["steps"].sum())

    @property
    def longest(self) -> float:
        """The longest substep [s]."""
        return float(np.max(self.schedule["dt"], initial=0.0))

    def substep_times(self) -> np.ndarray:
        """(n + 1,) times of all substep boundaries [s]."""
        s = self.schedule
        times = s["start"] + np.r_[0.0, np.cumsum(np.repeat(s["dt"], s["steps"]))]
        if s.get("paired"):
            times[1::2] = times[:-1:2] + FIRST_OF_PAIR * (times[2::2] - times[:-1:2])
        return times


def timeline_of(
    recording: Recording,
    last: int,
    substep: float,
    *,
    release_shift: float = 0.0,
    late: float = 0.0,
    first: int | None = None,
    implicit: bool = False,
    paired: bool = False,
) -> Timeline:
    """Frames 0..last-1 and the substeps between them; motion starts at the release.

    substep: longest [s]; late: how much later than stated every frame was taken [s]; first: a frame in
    mid-motion to begin at instead, whose state is given; implicit: whether the substeps are implicit;
    paired: and an even number in each span.
    Raises SimulationError where too many substeps, or none, cover the frames: a model stiff without bound.
    """
    fps, release = recording.fps, recording.release
    if first is not None:
        frames = np.arange(first, last)
        start, moving, resting, skipped = first / fps + late, frames[1:], 0, 0
    else:
        frames = np.arange(last)
        start = 0.0 if release is None else max(release / fps + release_shift, 0.0)
        if release is None and late == 0.0:
            moving, resting, skipped = frames[1:], 0, 0
        else:
            # Before the start all rests; the run's own first state is then shown by no frame.
            moving = frames[frames / fps + late > start + 1e-9]
            resting, skipped = last - len(moving), 1
    clock, times = frames / fps + late, moving / fps + late
    spans = np.diff(np.r_[start, times])
    if not (substep > 0.0 and spans.sum() / substep <= MOST_SUBSTEPS):
        raise SimulationError(
            f"no stable substep: {substep:g} s; expected at most {MOST_SUBSTEPS:.0e} in a run of "
            f"{spans.sum():.3g} s"
        )
    steps = np.maximum(np.ceil(spans / substep - 1e-9), 1).astype(np.int32)
    if implicit and paired:
        steps += steps % 2
    schedule = {"steps": steps, "dt": spans / np.maximum(steps, 1), "start": start}
    if implicit:
        schedule["implicit"] = True
        schedule["paired"] = paired
    return Timeline(frames, clock, moving, schedule, times, resting, skipped)


def poses_of(recording: Recording, timeline: Timeline) -> np.ndarray:
    """(H, n + 1, 12) rigid pose of every hold at every substep: rotation by rows, then position [m]."""
    times = timeline.substep_times()
    out = np.empty((len(recording.held), len(times), 12))
    for h, hold in enumerate(recording.held):
        rotation, position = hold.poses(times, recording.fps)
        out[h, :, :9] = rotation.reshape(-1, 9)
        out[h, :, 9:] = position
    return out
