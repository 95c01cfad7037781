"""Runs in shorter steps where one does not converge."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TypeVar

import numpy as np

from mphygs.simulate.errors import SimulationError
from mphygs.simulate.timeline import Timeline

# A step is halved so many times at the most.
HALVINGS = 4

Run = TypeVar("Run")


def in_steps_that_do(timeline: Timeline, run: Callable[[Timeline], Run]) -> tuple[Run, Timeline]:
    """What `run` gives, and the timeline on which it could.

    Where a step before a frame does not converge, as where a sheet snaps through, those before it are halved
    and the run is begun anew; with every further failure twice as many frames from there on, for what is
    hard to follow is so for a while. What comes out depends on the run alone, not on others before it.
    Raises SimulationError where steps of a sixteenth do not converge either.
    """
    steps, reach = timeline.schedule["steps"], 1
    finest = steps << HALVINGS
    while True:
        try:
            return run(timeline), timeline
        except SimulationError as error:
            span = error.frame - 1
            if not error.shorter or timeline.schedule["steps"][span] >= finest[span]:
                raise
            timeline = _halved(timeline, slice(span, span + reach), finest)
            reach *= 2


def _halved(timeline: Timeline, spans: slice, finest: np.ndarray) -> Timeline:
    """The same frames, in half the steps before some of them."""
    schedule = timeline.schedule
    steps = schedule["steps"].copy()
    steps[spans] = np.minimum(2 * steps[spans], finest[spans])
    dt = timeline.spans / np.maximum(steps, 1)
    return replace(timeline, schedule=schedule | {"steps": steps, "dt": dt})
