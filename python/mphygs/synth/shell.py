"""An independent simulator of strips: thin shells of cubic splines, in implicit steps.

It shares no code with the model, only what reads a capture. Normals stay straight and square to the middle;
the material is Hooke's in plane stress.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from mphygs.capture.format import Capture
from mphygs.capture.record import Sequence as Recording
from mphygs.synth.shell_body import KNOWN, ShellBody
from mphygs.synth.simulated_motion import SimulatedMotion
from mphygs.synth.thin_film import check_film, film

if TYPE_CHECKING:
    from mphygs.synth.hidden import Hidden
    from mphygs.synth.recipe import Recipe

# Of the spacing of a lattice as fine, size of an element: its splines are cubic and sixteen carry a point.
ELEMENT = 4.0


def simulate_shell(
    capture: Capture,
    recording: Recording,
    recipe: Recipe,
    hidden: Sequence[Hidden],
    spacing: float,
    progress: Callable[[int], bool] | None = None,
) -> SimulatedMotion:
    """True motion of the markers of one recording.

    spacing: of a grid as fine as the elements [m]; progress: told the number of frames after release that are
    done. Raises ValueError for objects and effects that it does not know, RuntimeError where no step is
    found.
    """
    if recipe.shape.sheet is None:
        raise ValueError(f"the simulator shell has no '{recipe.shape.name}'; expected strip")
    check_film("shell", KNOWN, recording, hidden)
    return film(ShellBody(capture, recording, recipe, hidden, ELEMENT * spacing), recording, progress)
