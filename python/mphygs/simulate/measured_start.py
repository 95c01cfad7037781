"""Numbers of a belief that say how one sequence's motion begins, where it does not begin at rest."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mphygs.capture.format import Capture
from mphygs.capture.record import Sequence as Recording
from mphygs.model.belief import Belief, Parameter
from mphygs.simulate.body import hold_boxes
from mphygs.simulate.start_shapes import HeldAt, StartOnGrid, start_shapes
from mphygs.simulate.transfer import Start, Transfer

SHAPE, SPEED = "start_shape_", "start_speed_"


def start_keys(sequence: str, count: int) -> list[str]:
    """Keys of the amplitudes [m] of a sequence's `count` slowest shapes in frame 0, then of their speeds."""
    return [f"{sequence}.{kind}{k}" for kind in (SHAPE, SPEED) for k in range(count)]


def start_sequence(parameter: Parameter) -> str | None:
    """The sequence whose start a parameter tells, None for all others."""
    sequence, _, quantity = parameter.key.rpartition(".")
    return sequence if quantity.startswith((SHAPE, SPEED)) else None


def of_sequence(parameter: Parameter) -> str | None:
    """The one sequence that a parameter is about: when it is let go or how it begins; None for all others."""
    sequence, _, quantity = parameter.key.rpartition(".")
    return sequence if quantity == "release_shift" else start_sequence(parameter)


def start_numbers(belief: Belief, sequence: str) -> tuple[np.ndarray, np.ndarray] | None:
    """Amplitudes (m,) [m] and speeds (m,) [m/s] of a sequence in frame 0, None where it begins at rest."""
    own = [p.value for p in belief.parameters if start_sequence(p) == sequence]
    return None if not own else tuple(np.split(np.array(own), 2))


class MeasuredStart:
    """The state of one sequence's carriers in frame 0."""

    def __init__(self, capture: Capture, recording: Recording, transfer: Transfer) -> None:
        self._capture, self._recording, self._transfer = capture, recording, transfer
        self._on_grid: StartOnGrid | None = None
        self._kept: tuple[bytes, Start] | None = None

    def at(self, belief: Belief, time: float) -> Start | None:
        """The state at a belief, None where it is rest. time: of frame 0 [s]."""
        numbers = start_numbers(belief, self._recording.name)
        if numbers is None:
            return None
        key = np.array([*numbers[0], *numbers[1], time]).tobytes()
        if self._kept is None or self._kept[0] != key:
            self._kept = key, self._start(*self._grid().state(*numbers, self._held(time)))
        return self._kept[1]

    def slopes(self, belief: Belief, parameters: Sequence[Parameter], time: float) -> list[Start]:
        """Derivatives of the state by coordinates of its own parameters."""
        keys = [p.key for p in belief.parameters if start_sequence(p) == self._recording.name]
        found = self._grid().slopes(*start_numbers(belief, self._recording.name), self._held(time))
        wanted = [(found[keys.index(p.key)], p.slope) for p in parameters]
        return [self._start(*(slope * field for field in fields)) for fields, slope in wanted]

    def _held(self, time: float) -> HeldAt:
        return HeldAt.of(self._recording.held, time, self._recording.fps)

    def _grid(self) -> StartOnGrid:
        if self._on_grid is None:
            shapes = start_shapes(self._capture, hold_boxes(self._recording))
            self._on_grid = StartOnGrid(shapes, self._transfer.grid_body)
        return self._on_grid

    def _start(self, displacement: np.ndarray, velocity: np.ndarray) -> Start:
        moved, gradient = self._transfer.from_grid(displacement)
        return Start(0, moved, self._transfer.from_grid(velocity)[0], gradient)
