"""`mphygs track CAPTURE`: points of the object followed through its videos."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mphygs.commands.command import Answer, run
from mphygs.commands.console import Console
from mphygs.commands.video_options import PICTURE, TracksOptions
from mphygs.motion.stage_pictures import frames_shown, write_track_picture
from mphygs.motion.video_stages import track_stage

PROGRAM = "mphygs track"


@dataclass(frozen=True, kw_only=True)
class TrackOptions(TracksOptions):
    """Follow the Gaussians of the object through its videos, frame by frame; go on where that was broken off.
    A tracks.npz of your own in RUN/stages/track/SEQUENCE is kept and used."""


def main(argv: Sequence[str] | None = None) -> int:
    """The command; returns its exit code."""
    return run(TrackOptions, track_command, program=PROGRAM, argv=argv)


def track_command(options: TrackOptions, console: Console) -> Answer:
    """Follow every sequence that was not followed yet; a picture of each."""
    count = options.count()
    console.resume = options.resume(PROGRAM)
    video_run = options.open()
    recordings = options.recordings(video_run)
    documents, lines = {}, []
    for number, recording in enumerate(recordings):

        def report(share: float, text: str, number: int = number) -> None:
            console.progress((number + share) / len(recordings), text)

        tracks, followed = track_stage(
            video_run, recording, rule=options.rule(), count=count, report=report
        )
        file = video_run.files.tracks(recording.name)
        picture = file.with_name(PICTURE)
        views = video_run.views(recording)
        shown = {frame: video_run.read(views, frame) for frame in frames_shown(recording.frames)}
        write_track_picture(picture, shown, tracks)
        seen = np.isfinite(tracks.position).all(axis=2)
        document = {
            "file": str(file),
            "picture": str(picture),
            "tracks": len(tracks.rest),
            "frames": recording.frames,
            "seen": float(seen.mean()),
            "sigma": float(np.median(tracks.sigma)),
        }
        if followed is not None:
            document["difference"] = float(np.median(followed.difference))
        documents[recording.name] = document
        lines.append(
            f"{recording.name}: {len(tracks.rest)} tracks through {recording.frames} frames, seen in "
            f"{seen.mean():.0%} of them, sigma {1e3 * document['sigma']:.2f} mm"
            f"{'' if followed is not None else ', as they were'}; {document['picture']}"
        )
    return Answer({"run": str(options.out), "sequences": documents}, "\n".join(lines))
