"""Options of the commands that follow an object through videos."""

from __future__ import annotations

import shlex
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated

import tyro

from mphygs.capture.format import load_capture
from mphygs.capture.layouts import SCALES
from mphygs.capture.record import Sequence as Recording
from mphygs.capture.stages import StageFolder
from mphygs.commands.claim import claim
from mphygs.commands.options import CommonOptions, OptionError, split_names
from mphygs.motion.tracking import TrackingRule
from mphygs.motion.video_stages import VideoRun

# A stage's picture, in its folder.
PICTURE = "picture.png"
LEAST_TRACKS = 20


@dataclass(frozen=True, kw_only=True)
class VideoOptions(CommonOptions):
    """Options of the commands that follow an object through videos."""

    capture: tyro.conf.Positional[Path]
    """Folder of the capture."""
    out: Path
    """Run folder; files go to RUN/stages."""
    sequences: Annotated[str | None, tyro.conf.arg(metavar="A,B")] = None
    """Sequences; default: all with videos."""
    gaussians: Path | None = None
    """The object at rest as a 3DGS .ply; default: RUN/stages/rest/gaussians.ply."""
    scale: float | None = None
    """Metres per unit of --gaussians; default: 1."""
    control_points: int = 250
    """Points that carry the Gaussians."""
    longest: int = 400
    """Pictures larger than this along a side are used at a half, a third, ... of their size [px]."""

    def rule(self) -> TrackingRule:
        """How Gaussians are followed. Raises OptionError."""
        try:
            return TrackingRule(control_points=self.control_points)
        except ValueError as error:
            raise OptionError(f"--control-points: got {self.control_points}; expected at least 5") from error

    def open(self) -> VideoRun:
        """What the stages work on; the run folder is held from here."""
        if self.scale is not None and (self.gaussians is None or not SCALES[0] <= self.scale <= SCALES[1]):
            why = f"{SCALES[0]:g} to {SCALES[1]:g} metres per unit of --gaussians, beside it"
            raise OptionError(f"--scale: got {self.scale:g}; expected {why}")
        claim(self.out)
        if self.longest < 16:
            raise OptionError(f"--longest: got {self.longest}; expected at least 16")
        scale = 1.0 if self.scale is None else self.scale
        capture = load_capture(self.capture)
        file = self.gaussians or StageFolder.of(self.out).gaussians
        if self.gaussians is None and not file.is_file() and capture.gaussians is not None:
            file, scale = capture.gaussians, capture.gaussians_scale
        if not file.is_file():
            raise OptionError(
                f"{file}: is not there; expected Gaussians of the object at rest, by mphygs reconstruct "
                f"{self.capture} --out {self.out}, or a file of your own by --gaussians"
            )
        return VideoRun.of(capture, self.out, file, self.longest, scale)

    def recordings(self, run: VideoRun) -> list[Recording]:
        """The sequences that are named, or all that have videos. Raises OptionError, CaptureError."""
        if self.sequences is None:
            return run.recordings()
        try:
            return [run.capture.sequence(name) for name in split_names(self.sequences)]
        except KeyError as error:
            raise OptionError(f"--sequences: {error.args[0]}") from error

    def resume(self, program: str) -> str:
        """The command line that goes on where it was broken off: all options that are not as usual."""
        words = [program, shlex.quote(str(self.capture))]
        for option in fields(self):
            value = getattr(self, option.name)
            if option.name == "capture" or value == option.default:
                continue
            words.append("--" + option.name.replace("_", "-"))
            if value is not True:
                words.append(shlex.quote(str(value)))
        return " ".join(words)


@dataclass(frozen=True, kw_only=True)
class TracksOptions(VideoOptions):
    """Options of the commands that work on tracks."""

    tracks: int = 2000
    """Most tracks that are kept."""

    def count(self) -> int:
        """Most tracks that are kept. Raises OptionError."""
        if self.tracks < LEAST_TRACKS:
            raise OptionError(f"--tracks: got {self.tracks}; expected at least {LEAST_TRACKS}")
        return self.tracks
