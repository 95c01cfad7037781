"""`mphygs contact CAPTURE`: what a hand holds, and how it moves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import tyro

from mphygs.commands.command import Answer, run
from mphygs.commands.console import Console
from mphygs.commands.options import OptionError
from mphygs.commands.video_options import PICTURE, TracksOptions
from mphygs.motion.contact_motion import coarse_contact
from mphygs.motion.stage_pictures import write_contact_picture
from mphygs.motion.video_stages import contact_stage

PROGRAM = "mphygs contact"
_FROM = {
    "own": "your own file",
    "capture": "as the capture gives it",
    "made": "as it was found before",
    "new": "found from tracks about the pixels that were pointed at",
}


@dataclass(frozen=True, kw_only=True)
class ContactOptions(TracksOptions):
    """What is held, and its motion: the capture's own hold where it has one with poses, else from tracks and
    contact.json. A hold.npz of your own in RUN/stages/contact/SEQUENCE is kept and used."""

    radius: Annotated[float | None, tyro.conf.arg(metavar="m")] = None
    """How far about the contact the object is held [m]; default: as far as it moves rigidly."""
    estimate: bool = False
    """Find the motion in the videos even where the capture gives it."""


def main(argv: Sequence[str] | None = None) -> int:
    """The command; returns its exit code."""
    return run(ContactOptions, contact_command, program=PROGRAM, argv=argv)


def contact_command(options: ContactOptions, console: Console) -> Answer:
    """The hold of every sequence; a picture of each."""
    if options.radius is not None and not options.radius > 0.0:
        raise OptionError(f"--radius: got {options.radius}; expected a length above 0 m")
    count = options.count()
    console.resume = options.resume(PROGRAM)
    video_run = options.open()
    recordings = options.recordings(video_run)
    documents, lines = {}, []
    for number, recording in enumerate(recordings):

        def report(share: float, text: str, number: int = number) -> None:
            console.progress((number + share) / len(recordings), text)

        hold, source, grip = contact_stage(
            video_run,
            recording,
            rule=options.rule(),
            count=count,
            radius=options.radius,
            estimate=options.estimate,
            report=report,
        )
        file = video_run.files.hold(recording.name)
        picture = file.with_name(PICTURE)
        views = video_run.views(recording)
        coarse = None
        if views.contact:
            cameras = {name: views.views[name, 0].camera for name in views.cameras}
            coarse = coarse_contact(cameras, views.contact, recording.frames)
        at = grip.motion.at if grip is not None else None
        write_contact_picture(picture, hold, recording.fps, at, coarse if at is not None else None)
        document: dict[str, object] = {
            "file": str(file),
            "picture": str(picture),
            "from": source,
            "box": hold.box.tolist(),
        }
        text = f"{recording.name}: {_FROM[source]}"
        if grip is not None:
            document |= {"held_tracks": len(grip.held), "residual": grip.residual, "at": at.tolist()}
            text += f", {len(grip.held)} tracks that are {1e3 * grip.residual:.2f} mm off one rigid motion"
        documents[recording.name] = document
        lines.append(f"{text}; {document['picture']}")
    return Answer({"run": str(options.out), "sequences": documents}, "\n".join(lines))
