"""An independent simulator of cables: geometrically exact rods, in implicit steps.

It shares no code with the model, only what reads a capture and turns; and no assumption but that of Hooke: a
section stays plane and stiff, its torsion is St. Venant's.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from mphygs.capture.format import Capture
from mphygs.capture.record import Sequence as Recording
from mphygs.synth.implicit_motion import march
from mphygs.synth.motion import Motion
from mphygs.synth.rod_body import KNOWN, RodBody

if TYPE_CHECKING:
    from mphygs.synth.hidden import Hidden
    from mphygs.synth.recipe import Recipe

# Of a frame: a swing of 6 Hz filmed at 100 frames a second falls behind by 1e-4 of its period then.
STEPS_A_FRAME = 16
# Causes that are stresses inside a part, which a rod has none of.
INSIDE = ("actuation",)


def simulate_rod(
    capture: Capture,
    recording: Recording,
    recipe: Recipe,
    hidden: Sequence[Hidden],
    spacing: float,
    progress: Callable[[int], bool] | None = None,
) -> Motion:
    """True motion of the markers of one recording.

    spacing: of the nodes along the rods [m], at most; progress: told the number of frames after release that
    are done. Raises ValueError for objects and effects that it does not know, RuntimeError where no step is
    found.
    """
    if not recipe.shape.lines:
        raise ValueError(f"object '{recipe.shape.name}': not a rod; expected cable or branched-cable")
    if recording.sensors or recording.actuators:
        raise ValueError("the simulator rod has no sensors and no drive; expected markers alone")
    for thing in hidden:
        if thing.kind == "effect" and thing.name not in KNOWN or thing.name in INSIDE:
            raise ValueError(f"the simulator rod has no '{thing.name}'; expected some of {', '.join(KNOWN)}")
    body = RodBody(capture, recording, recipe, hidden, spacing)
    places = body.places(recording.markers.at)
    first, frames = recording.release or 0, recording.frames
    position = np.repeat(recording.markers.at[None], frames, axis=0)
    velocity = np.zeros_like(position)
    count = STEPS_A_FRAME * (frames - 1 - first)
    step = 1.0 / (STEPS_A_FRAME * recording.fps)
    for k, moment in enumerate(march(body, body.at_rest(), first / recording.fps, step, count), start=1):
        if k % STEPS_A_FRAME == 0:
            frame = first + k // STEPS_A_FRAME
            speed = body.gripped_velocity(moment.velocity, frame / recording.fps, moment.state)
            position[frame], velocity[frame] = body.carried(places, moment.state, speed)
            if progress:
                progress(frame - first)
    held = body.held[body.net.element[places.element]].all(axis=1)
    return Motion(position, velocity, ~held, count)
