"""`mphygs synth flower --out DIR --species NAME`: captures of flowers in pictures, with known truth."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated

import tyro

from mphygs.commands.command import Answer, run
from mphygs.commands.console import Console
from mphygs.commands.options import CommonOptions, OptionError, split_names
from mphygs.synth.flower.catalogue import SPECIES
from mphygs.synth.flower.flower_capture import make_flower
from mphygs.synth.flower.recording_settings import Shoot
from mphygs.synth.make import Made

PROGRAM = "mphygs synth flower"
USUAL = Shoot()


@dataclass(frozen=True, kw_only=True)
class FlowerOptions(CommonOptions):
    """Grow flowers, move them by a hand, and record them in pictures: dense views at rest, and two motions
    seen by a few cameras. Running the same command again goes on where it was broken off."""

    out: Path
    """Folder to write the capture to; of several species, each goes to a folder of its own in it."""
    species: Annotated[tuple[str, ...], tyro.conf.UseAppendAction, tyro.conf.arg(metavar="NAME")] = ()
    """Which flower, once for each, or all; default: daisy."""
    hidden: Annotated[str | None, tyro.conf.arg(metavar="a,b")] = None
    """Hidden effects, and causes outside the list of effects; each may have numbers: viscosity:eta=80."""
    seed: int = 0
    """Of growth, materials, motions and textures."""
    size: int = USUAL.size
    """Width and height of the pictures [px]."""
    rest_views: int = USUAL.rest_views
    """Pictures of the flower at rest."""
    cameras: int = USUAL.cameras
    """Cameras that see the motions."""
    frames: int = USUAL.frames
    """Frames of each motion, 50 a second."""
    tracks: int = USUAL.tracks
    """Number of true tracks."""
    noise: float = USUAL.noise
    """Standard deviation of the pictures' noise, of a range of 1."""
    spacing_share: float = USUAL.spacing_share
    """Grid spacing of the truth over the default spacing of a fit."""


def main(argv: Sequence[str] | None = None) -> int:
    """The command; returns its exit code."""
    return run(FlowerOptions, flower_command, program=PROGRAM, argv=argv)


def flower_command(options: FlowerOptions, console: Console) -> Answer:
    """Make the captures and say what is in them."""
    chosen = _chosen(options.species)
    try:
        shoot = Shoot(**{name: getattr(options, name) for name in USUAL.__dict__})
    except ValueError as error:
        name, _, rest = str(error).partition(" ")
        raise OptionError(f"--{name.replace('_', '-')}: got {rest}") from error
    console.resume = f"{PROGRAM} {shlex.join(_arguments(options))}"
    documents, lines = [], []
    for number, name in enumerate(chosen):

        def tell(share: float, text: str, number: int = number, name: str = name) -> None:
            console.progress((number + share) / len(chosen), f"{name}: {text}")

        folder = options.out if len(chosen) == 1 else options.out / name
        made = make_flower(
            name, folder, hidden=split_names(options.hidden), seed=options.seed, shoot=shoot, report=tell
        )
        documents.append(_document(name, made))
        lines += _text(name, made)
    document = {"out": str(options.out), "seconds": console.seconds, "flowers": documents}
    return Answer(document, "\n".join(lines))


def _arguments(options: FlowerOptions) -> list[str]:
    """The options as they would be typed, the usual ones left out."""
    arguments = []
    for field in fields(options):
        value = getattr(options, field.name)
        if value != field.default:
            name = f"--{field.name.replace('_', '-')}"
            values = value if isinstance(value, tuple) else (value,)
            arguments += [name] if value is True else [part for v in values for part in (name, str(v))]
    return arguments


def _chosen(given: tuple[str, ...]) -> tuple[str, ...]:
    chosen = tuple(dict.fromkeys(name for text in given for name in split_names(text))) or ("daisy",)
    if chosen == ("all",):
        return tuple(SPECIES)
    for name in chosen:
        if name not in SPECIES:
            raise OptionError(f"--species: got '{name}'; expected all, or some of {', '.join(SPECIES)}")
    return chosen


def _document(name: str, made: Made) -> dict[str, object]:
    keys = ("hidden", "effects", "parts", "seed", "differences", "largest_motion_m")
    return {"species": name, "capture": str(made.folder), "answer": str(made.folder / "answer.json")} | {
        key: made.answer[key] for key in keys
    }


def _text(name: str, made: Made) -> list[str]:
    answer = made.answer
    farthest = " and ".join(f"{1e3 * far:.0f} mm" for far in answer["largest_motion_m"])
    lines = [f"{name}: {', '.join(answer['parts'])}; moved by up to {farthest}"]
    lines += [f"hidden: {hidden}" for hidden in answer["hidden"] if hidden != "none"]
    for take, apart in answer["differences"].get("without_all", {}).items():
        lines.append(f"what is hidden moves it by {1e3 * apart['rms_difference_m']:.2f} mm rms in {take}")
    lines.append(f"  {made.folder}/capture.json, its truth in {made.folder}/truth and answer.json")
    return lines
