"""The stages of an image capture that are not there yet, run one after the other by their own commands."""

from __future__ import annotations

import importlib
import json
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from mphygs.capture.format import Capture
from mphygs.capture.record import Sequence as Recording
from mphygs.capture.stages import STAGES, Stage, StageFolder
from mphygs.capture.written import replace_file
from mphygs.commands.command import DONE, INTERRUPTED
from mphygs.commands.console import Console
from mphygs.fit.image_capture import is_pictured

SECONDS = "seconds.json"


class StageError(ValueError):
    """A stage that failed: it has said why."""


@dataclass(frozen=True)
class Making:
    """What makes a stage. command: its module; arguments: beyond capture and folder; file: that it leaves."""

    name: str
    command: str
    arguments: tuple[str, ...]
    file: Path

    @property
    def done(self) -> bool:
        """Whether the file is there and was not left half made."""
        return Stage.of(self.file, {}).complete()


def has_stages(capture: Capture) -> bool:
    """Whether anything of a capture has to be found in pictures first."""
    return is_pictured(capture) or any(_tracked(r) for r in capture.sequences)


def missing_stages(capture: Capture, folder: Path) -> list[Making]:
    """The stages whose files are not in the folder, in the order in which they are to be run."""
    files = StageFolder(folder)
    found = []
    if is_pictured(capture):
        if capture.gaussians is None:
            found.append(Making("reconstruct", "reconstruct", (), files.gaussians))
        found.append(Making("segment", "segment", (), files.particles))
    for recording in capture.sequences:
        if not _tracked(recording):
            continue
        name = recording.name
        own = ("--sequences", name)
        found.append(Making(f"track {name}", "track", own, files.tracks(name)))
        if not recording.held:
            found.append(Making(f"contact {name}", "contact", own, files.hold(name)))
        if not files.tracks(name).exists():
            found.insert(
                -1 if recording.held else -2, Making(f"register {name}", "register", own, files.pose(name))
            )
    return [making for making in found if not making.done]


def _tracked(recording: Recording) -> bool:
    """Whether a sequence has to be followed in its video."""
    return recording.views is not None and recording.markers is None


def run_stages(capture: Capture, path: Path, run: Path, console: Console) -> dict[str, float]:
    """Run what is missing and return the seconds that every stage has taken so far, by its name.

    path: of the capture; run: folder that has, or gets, the folder of the stages. Raises StageError, one
    line, where a stage failed; what was done before is kept.
    """
    folder = run / STAGES
    seconds = recorded_seconds(folder)
    stages = missing_stages(capture, folder)
    for number, stage in enumerate(stages):
        if stage.done:
            continue
        console.say(f"stage {number + 1} of {len(stages)}: {stage.name}")
        began = time.monotonic()
        module = importlib.import_module(f"mphygs.commands.{stage.command}")
        code = module.main([str(path), "--out", str(run), *stage.arguments])
        if code == INTERRUPTED:
            raise KeyboardInterrupt
        if code != DONE or not stage.file.exists():
            raise StageError(
                f"{stage.file}: was not made by mphygs {stage.command}; expected it, or your own file"
            )
        seconds[stage.name] = seconds.get(stage.name, 0.0) + time.monotonic() - began
        folder.mkdir(parents=True, exist_ok=True)
        replace_file(folder / SECONDS, json.dumps(seconds, indent=1) + "\n")
    return seconds


def recorded_seconds(folder: Path) -> dict[str, float]:
    """Seconds of the stages that were run, by name."""
    path = folder / SECONDS
    if not path.is_file():
        return {}
    try:
        return {str(name): float(value) for name, value in json.loads(path.read_text()).items()}
    except (json.JSONDecodeError, AttributeError, TypeError, ValueError):
        return {}


def names_of(stages: Sequence[Making]) -> str:
    """The stages in words."""
    return ", ".join(stage.name for stage in stages)
