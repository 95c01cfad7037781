"""`mphygs register CAPTURE`: where the object at rest is in frame 0 of its videos."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch

from mphygs.capture.rotation import rotation_vector_from_quaternion
from mphygs.commands.command import Answer, run
from mphygs.commands.console import Console
from mphygs.commands.video_options import PICTURE, VideoOptions
from mphygs.motion.rigid import RigidMotion
from mphygs.motion.stage_files import Registered
from mphygs.motion.stage_pictures import write_register_picture
from mphygs.motion.video_stages import register_stage

PROGRAM = "mphygs register"


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
    recordings = options.recordings(video_run)
    documents, lines = {}, []
    for number, recording in enumerate(recordings):
        console.progress(number / len(recordings), f"registering {recording.name}")
        registered, found = register_stage(video_run, recording, rule=options.rule())
        file = video_run.files.pose(recording.name)
        picture = file.with_name(PICTURE)
        photographs = video_run.read(video_run.views(recording), 0)
        positions = torch.as_tensor(registered.refined, dtype=torch.float32)
        moved = RigidMotion(registered.rotation, registered.position).of_gaussians(video_run.gaussians)
        write_register_picture(
            picture, photographs, video_run.gaussians, replace(moved, positions=positions)
        )
        document = _document(registered, video_run.gaussians.positions.numpy())
        document |= {"file": str(file), "picture": str(picture)}
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
