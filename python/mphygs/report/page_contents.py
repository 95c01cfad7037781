"""What a page is told of a run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from mphygs.capture.format import Capture
from mphygs.fit.run import Run


@dataclass(frozen=True, eq=False, kw_only=True)
class Contents:
    """All that a page tells.

    parameters, comparison, diagnosis, steps: as the commands print them, None for what was not run;
    diagnosis_before: of the model that this one was extended from; scene: see `scene_document`; films: video
    beside rendering by sequence; commands: that made it; force: what is said of the missing force, line by
    line; hidden: sequences that the scene has no room for; sensors: chart of what instruments measured, None
    where there are none.
    """

    run: Run
    capture: Capture
    parameters: Mapping[str, Mapping[str, object]]
    comparison: Mapping[str, object]
    scene: Mapping[str, object]
    commands: Sequence[str]
    films: Mapping[str, Mapping[str, object]] = field(default_factory=dict)
    diagnosis: Mapping[str, object] | None = None
    diagnosis_before: Mapping[str, object] | None = None
    steps: Mapping[str, object] | None = None
    force: Sequence[str] = ()
    hidden: Sequence[str] = ()
    sensors: Mapping[str, object] | None = None
