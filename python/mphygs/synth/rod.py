"""An independent simulator of cables: geometrically exact rods, in implicit steps.

It shares no code with the model, only what reads a capture and turns. A section stays plane and as it is; its
torsion is St. Venant's, its material Hooke's.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from mphygs.capture.format import Capture
from mphygs.capture.record import Sequence as Recording
from mphygs.synth.rod_body import KNOWN, RodBody
from mphygs.synth.simulated_motion import SimulatedMotion
from mphygs.synth.thin_film import check_film, film

if TYPE_CHECKING:
    from mphygs.synth.hidden import Hidden
    from mphygs.synth.recipe import Recipe


def simulate_rod(
    capture: Capture,
    recording: Recording,
    recipe: Recipe,
    hidden: Sequence[Hidden],
    spacing: float,
    progress: Callable[[int], bool] | None = None,
) -> SimulatedMotion:
    """True motion of the markers of one recording.

    spacing: of the nodes along the rods [m], at most; progress: told the number of frames after release that
    are done. Raises ValueError for objects and effects that it does not know, RuntimeError where no step is
    found.
    """
    if not recipe.shape.lines:
        raise ValueError(f"the simulator rod has no '{recipe.shape.name}'; expected cable or branched-cable")
    check_film("rod", KNOWN, recording, hidden)
    return film(RodBody(capture, recording, recipe, hidden, spacing), recording, progress)
