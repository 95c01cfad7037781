"""A film of a thin structure that moves in implicit steps."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from mphygs.capture.record import Sequence as Recording
from mphygs.synth.implicit_motion import march
from mphygs.synth.simulated_motion import SimulatedMotion

if TYPE_CHECKING:
    from mphygs.synth.hidden import Hidden
    from mphygs.synth.rod_body import RodBody
    from mphygs.synth.shell_body import ShellBody

# Of a frame: a swing of 6 Hz filmed at 100 frames a second falls behind by 1e-4 of its period then.
STEPS_A_FRAME = 16
# Where a step is not found all are halved and the film begins anew, down to this share of them.
FINEST = 8
# Causes that are stresses inside a part, which a thin structure has none of.
INSIDE = ("actuation",)


def check_film(name: str, known: Sequence[str], recording: Recording, hidden: Sequence[Hidden]) -> None:
    """Raises ValueError for what a simulator of that name, of such effects, cannot have."""
    if recording.sensors or recording.actuators:
        raise ValueError(f"the simulator {name} has no sensors and no drive; expected markers alone")
    for thing in hidden:
        if (thing.kind == "effect" and thing.name not in known) or thing.name in INSIDE:
            raise ValueError(
                f"the simulator {name} has no '{thing.name}'; expected some of {', '.join(known)}"
            )


def film(
    body: RodBody | ShellBody, recording: Recording, progress: Callable[[int], bool] | None = None
) -> SimulatedMotion:
    """The markers of a recording on a body. progress: told the number of frames after release that are done.

    Raises RuntimeError where no step is found.
    """
    steps = STEPS_A_FRAME
    while True:
        try:
            return _in_steps(steps, body, recording, progress)
        except RuntimeError:
            steps *= 2
            if steps > FINEST * STEPS_A_FRAME:
                raise


def _in_steps(
    steps: int,
    body: RodBody | ShellBody,
    recording: Recording,
    progress: Callable[[int], bool] | None,
) -> SimulatedMotion:
    """steps: of a frame."""
    places = body.places(recording.markers.at)
    first, frames = recording.release or 0, recording.frames
    position = np.repeat(recording.markers.at[None], frames, axis=0)
    velocity = np.zeros_like(position)
    count, step = steps * (frames - 1 - first), 1.0 / (steps * recording.fps)
    for k, moment in enumerate(march(body, body.at_rest(), first / recording.fps, step, count), start=1):
        if k % steps == 0:
            frame = first + k // steps
            position[frame], velocity[frame] = body.carried(
                places, moment.state, moment.velocity, frame / recording.fps
            )
            if progress:
                progress(frame - first)
    return SimulatedMotion(position, velocity, ~places.held, count)
