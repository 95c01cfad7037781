"""`mphygs register CAPTURE`: where the object at rest is in frame 0 of its videos."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Annotated

import numpy as np
import torch
import tyro

from mphygs.capture.layouts import SCALES
from mphygs.capture.rotation import rotation_vector_from_quaternion
from mphygs.claim import claim
from mphygs.command import Answer, CommonOptions, Console, OptionError, run
from mphygs.motion.pictures import write_register_picture
from mphygs.motion.rigid import RigidMotion
from mphygs.motion.stage_files import STAGES, Registered
from mphygs.motion.tracking import TrackingRule
from mphygs.motion_stages import POSE, VideoRun, register_stage

PROGRAM = "mphygs register"
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
        scale = 1.0 if self.scale is None else self.scale
        return VideoRun.open(self.capture, self.out, self.gaussians, self.longest, scale)

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


@dataclass(frozen=True, kw_only=True)
class RegisterOptions(VideoOptions):
    """Where the object at rest is in frame 0 of its videos: a rigid motion, then a little of every Gaussian.
    A pose.npz of your own in RUN/stages/register/SEQUENCE is kept and used."""


def main(argv: Sequence[str] | None = None) -> int:
    """The command; returns its exit code."""
    return run(RegisterOptions, register_command, program=PROGRAM, argv=argv)


def register_command(options: RegisterOptions, console: Console) -> Answer:
    """Register every sequence that is not registered; a picture of each."""
    console.resume = options.resume(PROGRAM)
    video_run = options.open()
    recordings = video_run.recordings(options.sequences)
    documents, lines = {}, []
    for number, recording in enumerate(recordings):
        console.progress(number / len(recordings), f"registering {recording.name}")
        registered, found = register_stage(video_run, recording, rule=options.rule())
        folder = options.out / STAGES / "register" / recording.name
        photographs = video_run.read(video_run.views(recording), 0)
        positions = torch.as_tensor(registered.refined, dtype=torch.float32)
        moved = RigidMotion(registered.rotation, registered.position).of_gaussians(video_run.gaussians)
        write_register_picture(
            folder / PICTURE, photographs, video_run.gaussians, replace(moved, positions=positions)
        )
        document = _document(registered, video_run.gaussians.positions.numpy())
        document |= {"file": str(folder / POSE), "picture": str(folder / PICTURE)}
        if found is not None:
            document |= {
                "by": found.by,
                "points": len(found.apart),
                "points_used": int(found.agree.sum()),
                "points_rms": float(np.sqrt(np.mean(found.apart[found.agree] ** 2)))
                if found.agree.any()
                else None,
                "difference": found.difference,
            }
        documents[recording.name] = document
        lines.append(_line(recording.name, document))
    return Answer({"run": str(options.out), "sequences": documents}, "\n".join(lines))


def _document(registered: Registered, rest: np.ndarray) -> dict[str, object]:
    turn = float(np.degrees(np.linalg.norm(rotation_vector_from_quaternion(registered.quaternion))))
    rigid = rest @ registered.rotation.T + registered.position
    bent = np.linalg.norm(registered.refined - rigid, axis=1)
    moved = float(np.linalg.norm((rigid - rest).mean(axis=0)))
    return {"turned_degrees": turn, "moved": moved, "refined_median": float(np.median(bent))}


def _line(name: str, document: dict[str, object]) -> str:
    by = f", by {document['by']}" if "by" in document else ", as it was"
    if document.get("points"):
        by += f": {document['points_used']} of {document['points']} points, "
        by += f"{1e3 * document['points_rms']:.2f} mm"
    return (
        f"{name}: moved {1e3 * document['moved']:.2f} mm, turned {document['turned_degrees']:.2f} degrees, "
        f"Gaussians by another {1e3 * document['refined_median']:.2f} mm{by}; {document['picture']}"
    )


if __name__ == "__main__":
    sys.exit(main())
