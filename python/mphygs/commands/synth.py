"""`mphygs synth KIND --hidden a,b --out DIR`: a capture with known truth."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from mphygs.commands.claim import claim_capture
from mphygs.commands.command import Answer, run
from mphygs.commands.console import Console
from mphygs.commands.options import CommonOptions, OptionError, split_names
from mphygs.commands.synth_flower import main as flower
from mphygs.synth.drive import Drive
from mphygs.synth.faults import DEFAULTS as FAULTS
from mphygs.synth.make import make_capture
from mphygs.synth.marker_noise import NOISES, Noise
from mphygs.synth.recipe import Recipe, default_takes, recipe
from mphygs.synth.shapes import shape

PROGRAM = "mphygs synth"
# Seconds between two lines of progress.
TOLD_EVERY = 10.0
# Objects of prisms whose name here is another than in the library.
PRISMS = {"prism-flower": "flower"}


@dataclass(frozen=True, kw_only=True)
class SynthOptions(CommonOptions):
    """Make a capture with known truth: simulated on another grid than a fit's, then measured with noise."""

    kind: tyro.conf.Positional[
        Literal[
            "bar",
            "two-part-bar",
            "prism-flower",
            "hanging-flower",
            "block-flower",
            "hanging-block-flower",
            "cable",
            "branched-cable",
            "strip",
            "thin-flower",
            "flower",
        ]
    ]
    """The object; cable, branched-cable, strip and thin-flower are as thin and as stiff as such things are;
    flower, seen in pictures, has options of its own: synth flower --help."""
    out: Path
    """Folder to write the capture and its answer.json to."""
    hidden: Annotated[str | None, tyro.conf.arg(metavar="a,b")] = None
    """Hidden effects, and causes outside the list of effects; each may have numbers: viscosity:eta=80."""
    fault: Annotated[str | None, tyro.conf.arg(metavar="a,b")] = None
    """Faults of the measurement, in the same way: time_offset:offset=0.01."""
    motion: Annotated[str | None, tyro.conf.arg(metavar="a,b")] = None
    """Movements of the hold in the motion to fit, of cables of the far one: shake, rock, shift, turn;
    default: as suits the object."""
    start: Literal["rest", "pulled", "moving"] = "rest"
    """rest: the motion begins at rest; pulled: frame 0 is where the object, pulled aside, is let go; moving:
    frame 0 is in the midst of a movement of the hold."""
    drive: str | None = None
    """What moves a bar whose hold stands still, and the capture states frame by frame: tendon or pressure;
    tendon:gain=0.8:delay=0.01 arrives so much weaker and later than stated, and leaves both to be found."""
    noise: Literal[NOISES] = "white"
    """White, or half its variance correlated in time, or half of it common to all markers of a frame, or half
    of it that of values rounded to a grid; or white, but with heavy tails, or growing fourfold."""
    sigma: float = 2e-4
    """Standard deviation of the noise of one coordinate [m]."""
    dropout: float = 0.02
    """Share of the marker positions that are missing."""
    frames: int = 80
    """Frames of each motion."""
    markers: int = 120
    """Number of markers, half inside the object and half on its surface; on cables crosses of four."""
    sensors: Annotated[str | None, tyro.conf.arg(metavar="a,b")] = None
    """Instruments beside the markers: force, torque (of the hold, with the force), acceleration (of the tip,
    gravity included); each may have its noise: force:sigma=0.01."""
    known: Literal["first-density", "densities", "mass", "none"] = "first-density"
    """What the capture tells of the masses: density of the first part, of all parts, the whole mass, or
    nothing."""
    spacing_share: float = 0.62
    """Grid spacing of the truth over that at which the object is worth 250 cells."""
    simulator: Literal["total-lagrangian", "mls", "finite-element", "rod", "shell"] | None = None
    """What computes the truth: the core by one of its transfers on a grid of its own; or, independent of it,
    finite elements, which take bars and flowers of blocks, geometrically exact rods, which take cables, or a
    Kirchhoff-Love shell, which takes strips; default: rod and shell for these, else total-lagrangian."""
    seed: int = 0
    """Of materials, marker places and noise."""


def main(argv: Sequence[str] | None = None) -> int:
    """The command; returns its exit code."""
    given = list(sys.argv[1:] if argv is None else argv)
    if given[:1] == ["flower"]:
        return flower(given[1:])
    return run(SynthOptions, synth_command, program=PROGRAM, argv=argv)


def synth_command(options: SynthOptions, console: Console) -> Answer:
    """Make the capture and say what is hidden in it."""
    claim_capture(options.out)
    made_of = _recipe(options)
    last: tuple[str, float] | None = None

    def tell(share: float, text: str) -> None:
        nonlocal last
        if last is None or text != last[0] or console.seconds >= last[1] + TOLD_EVERY:
            console.progress(share, text)
            last = text, console.seconds

    made = make_capture(made_of, options.out, report=tell)
    answer = made.answer
    document = {"capture": str(made.folder), "answer": str(made.folder / "answer.json")}
    document |= {
        key: answer[key] for key in ("hidden", "effects", "faults", "parts", "signal_over_noise", "seed")
    }
    return Answer(document, _text(options, made_of, answer))


def _recipe(options: SynthOptions) -> Recipe:
    if options.kind == "flower":
        raise OptionError("flower: got options before it; expected the kind first: synth flower --out DIR")
    if options.frames < 8:
        raise OptionError(f"--frames: got {options.frames}; expected 8 or more")
    if not 0.3 <= options.spacing_share <= 2.0:
        raise OptionError(f"--spacing-share: got {options.spacing_share}; expected 0.3 to 2")
    faults, hidden = split_names(options.fault), split_names(options.hidden)
    for text in faults:
        if text.split(":")[0] not in FAULTS:
            raise OptionError(f"--fault: unknown fault '{text}'; expected some of {', '.join(FAULTS)}")
    kind = PRISMS.get(options.kind, options.kind)
    return recipe(
        kind,
        hidden=hidden + faults,
        seed=options.seed,
        noise=Noise(options.noise, options.sigma, dropout=options.dropout),
        takes=default_takes(
            shape(kind),
            frames=options.frames,
            kinds=split_names(options.motion),
            start=options.start,
            drive=None if options.drive is None else Drive.parse(options.drive),
        ),
        marker_count=options.markers,
        spacing_share=options.spacing_share,
        known=options.known,
        simulator=options.simulator,
        sensors=split_names(options.sensors),
    )


def _text(options: SynthOptions, made_of: Recipe, answer: dict) -> str:
    lines = [f"{made_of.name}: {', '.join(made_of.shape.part_names)}; {len(made_of.takes)} motions"]
    for thing in made_of.hidden:
        numbers = ", ".join(f"{k} = {v:g}" for k, v in thing.values.items())
        lines.append(f"hidden: {thing.name} ({thing.kind}; {numbers})")
    if answer["signal_over_noise"] is not None:
        lines.append(f"what is hidden moves the markers by {answer['signal_over_noise']:.1f} sigma")
    folder = shlex.quote(str(options.out))
    lines += [
        "",
        "next:",
        f"  mphygs discover {folder}    find what is hidden",
        f"  less {folder}/answer.json",
    ]
    return "\n".join(lines)
