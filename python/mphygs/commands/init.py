"""`mphygs init FOLDER`: a capture.json for a folder of meshes, markers and views."""

from __future__ import annotations

import json
import shlex
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import tyro

from mphygs.capture.document import Entry
from mphygs.capture.draft import Files, MarkerFile, find_files, read_marker_file, rest_of, sequence_entry
from mphygs.capture.files import transforms_files
from mphygs.capture.format import load_capture
from mphygs.capture.layouts import read_scale, unit_remarks
from mphygs.capture.save import FORMAT
from mphygs.capture.written import replace_file
from mphygs.commands.command import Answer, run
from mphygs.commands.console import Console
from mphygs.commands.options import CommonOptions, OptionError

PROGRAM = "mphygs init"


@dataclass(frozen=True, kw_only=True)
class InitOptions(CommonOptions):
    """Write a capture.json for a folder of files. Where a terminal is there, it asks for what is missing."""

    folder: tyro.conf.Positional[Path]
    """Folder with meshes (.ply, .stl, .obj), markers (.c3d, .npz, .csv), motions of holds (.npz with position
    and quaternion, named as the markers are) and folders of views (with a transforms.json, those of splits,
    or a COLMAP model); without meshes and views at rest, Gaussians (a 3DGS .ply)."""
    name: str | None = None
    """Of the capture; default: that of the folder."""
    fps: float | None = None
    """Frames per second; default: as a .c3d says."""
    held: Annotated[str | None, tyro.conf.arg(metavar="x,y,z:x,y,z;...")] = None
    """Boxes that hold the object, lower and upper corner [m], several separated by ";"; none: it is free."""
    gravity: Annotated[str, tyro.conf.arg(metavar="x,y,z")] = "0,0,-9.81"
    """In the object frame [m/s^2]."""
    scale: float | None = None
    """Metres per unit of the meshes, 0.001 where they are in mm; without meshes, per unit of the
    reconstruction that the views' cameras, or the Gaussians, come from. Default: 1."""
    known_length: Annotated[str | None, tyro.conf.arg(metavar="A,B,METRES")] = None
    """In place of --scale, a distance that was measured [m] and where it is in the reconstruction of the
    views at rest: between the cameras of two pictures, by name, or of two points of a COLMAP
    model, by number."""
    marker_scale: float = 1.0
    """Unit of .npz and .csv markers -> metre."""
    sigma: float = 2e-4
    """Standard deviation of a coordinate's noise [m]."""
    rest: Literal["stress-free", "equilibrium"] = "stress-free"
    """equilibrium: the meshes show the object as it sags under gravity."""
    mass: float | None = None
    """Of the whole object [kg], where it was weighed."""
    release: int | None = None
    """Frame until which all is held at rest."""
    share: float = 0.6
    """Share of the frames that are for fitting; the rest is kept for prediction."""
    frames: int | None = None
    """Frames of sequences that have views and no markers."""


def main(argv: Sequence[str] | None = None) -> int:
    """The command; returns its exit code."""
    return run(InitOptions, init_command, program=PROGRAM, argv=argv)


def init_command(options: InitOptions, console: Console) -> Answer:
    """Write capture.json, sure that it can be read; where it cannot be, it is taken away again."""
    folder = options.folder
    if not folder.is_dir():
        raise OptionError(f"{folder}: is no folder; expected one with meshes and markers, or views")
    target = folder / "capture.json"
    if target.exists() or target.is_symlink():
        raise OptionError(f"{target}: is there already; expected a folder without one")
    if not 0.0 < options.share <= 1.0:
        raise OptionError(f"--share: got {options.share:g}; expected above 0, at most 1")
    files = find_files(folder)
    boxes = _boxes(_asked(options.held, "what holds it, x,y,z:x,y,z;... in metres, or none", "none", console))
    made = []
    try:
        unit = _unit(files, options)
        shape = _shape(files, options, unit)
        sequences = _sequences(files, options, boxes, console, made)
        scale = read_scale(Entry(unit, str(target), "object"), files.rest_views) if unit else 1.0
        if scale != 1.0 and files.rest_views is not None:
            # One reconstruction, one unit.
            sequences = [entry | ({"scale": scale} if "views" in entry else {}) for entry in sequences]
        document = {
            "format": FORMAT,
            "name": options.name or folder.resolve().name,
            "gravity": _numbers(options.gravity, 3, "--gravity"),
            "object": {
                **shape,
                "rest": options.rest,
                "known": {} if options.mass is None else {"mass": options.mass},
            },
            "sequences": sequences,
        }
        made.append(target)
        replace_file(target, json.dumps(document, indent=1, allow_nan=False, ensure_ascii=False) + "\n")
        capture = load_capture(folder)
    except Exception:
        for path in made:
            path.unlink(missing_ok=True)
        raise
    count = len(capture.parts)
    what = f"{count} part{'s' if count > 1 else ''}" if count else "an object in pictures"
    lines = [f"{target}: {what}; {', '.join(s.name for s in capture.sequences)}"]
    if any(s.markers is not None for s in capture.sequences):
        lines.append("markers at rest are as the first frames show them: look at that, and at sigma")
    lines += unit_remarks(capture)
    lines += ["", f"next: mphygs doctor {shlex.quote(str(folder))}"]
    return Answer({"capture": str(folder), "document": document}, "\n".join(lines))


def _asked(given: str | None, question: str, default: str, console: Console) -> str:
    """What was given, or is answered where there is a terminal to ask at."""
    if given is not None or not sys.stdin.isatty():
        return default if given is None else given
    console.say(f"{question} [{default}]?")
    return sys.stdin.readline().strip() or default


def _numbers(text: str, count: int, where: str) -> list[float]:
    try:
        numbers = [float(word) for word in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) != count:
        raise OptionError(f"{where}: got '{text}'; expected {count} numbers separated by commas")
    return numbers


def _boxes(text: str) -> list[list[list[float]]]:
    if text == "none":
        return []
    boxes = []
    for word in text.split(";"):
        corners = word.split(":")
        if len(corners) != 2:
            raise OptionError(f"--held: got '{word}'; expected x,y,z:x,y,z, or none")
        boxes.append([_numbers(corner, 3, "--held") for corner in corners])
    return boxes


def _shape(files: Files, options: InitOptions, unit: Mapping[str, object]) -> dict[str, object]:
    if files.meshes:
        names = [mesh.stem.replace(".", "_") for mesh in files.meshes]
        parts = [
            {"name": name, "mesh": mesh.name, "scale": 1.0 if options.scale is None else options.scale}
            for name, mesh in zip(names, files.meshes, strict=True)
        ]
        return {"parts": parts}
    if files.rest_views is not None:
        return {"views": files.rest_views.name, **unit}
    if files.gaussians is not None:
        return {"gaussians": files.gaussians.name, **unit}
    raise OptionError(
        f"{options.folder}: has no mesh, no folder of views at rest and no Gaussians; expected one of them"
    )


def _unit(files: Files, options: InitOptions) -> dict[str, object]:
    """What is said of the unit of views at rest, or of Gaussians; nothing where they are in metres, or there
    are none."""
    shape = "meshes" if files.meshes else "Gaussians" if files.rest_views is None and files.gaussians else ""
    if options.known_length is not None and (options.scale is not None or shape):
        where = f"the object is given by {shape}" if shape else "--scale is given as well"
        raise OptionError(f"--known-length: {where}; expected {'--scale' if shape else 'one of them'}")
    if files.meshes or (files.rest_views is None and files.gaussians is None):
        return {}
    if options.known_length is None or files.rest_views is None:
        return {} if options.scale is None else {"scale": options.scale}
    words = [word.strip() for word in options.known_length.split(",")]
    try:
        a, b, metres = words[0], words[1], float(words[2])
    except (IndexError, ValueError):
        words = []
    if len(words) != 3:
        raise OptionError(f"--known-length: got '{options.known_length}'; expected A,B,METRES")
    # Only a COLMAP model has points, by number.
    points = not transforms_files(files.rest_views)
    ends = [int(end) if points and end.isascii() and end.isdigit() else end for end in (a, b)]
    return {"known_length": [ends, metres]}


def _sequences(
    files: Files, options: InitOptions, boxes: Sequence[object], console: Console, made: list[Path]
) -> list[dict[str, object]]:
    """One for each marker file and folder of videos; those of one name are one. made: files written."""
    found: list[dict[str, object]] = []
    views = dict(files.views)
    for path in files.markers:
        tracks = read_marker_file(options.folder, path, scale=options.marker_scale, fps=options.fps)
        if tracks.file != path.name:
            made.append(options.folder / tracks.file)
        name = path.stem.removesuffix("_markers").removesuffix("-markers")
        motions = files.motions.get(path.stem, ())
        if len(motions) > len(boxes):
            raise OptionError(
                f"--held: {len(boxes)} boxes; expected {len(motions)}, one for each motion of {name}"
            )
        moved = [*(motion.name for motion in motions), *["fixed"] * len(boxes)]
        held = [{"box": box, "motion": motion} for box, motion in zip(boxes, moved, strict=False)]
        fps, at = _rate(options, tracks.fps, path.name, console), rest_of(path, tracks, options.release)
        shown = views.pop(name, None)
        found.append(_entry(options, name, tracks, held, fps, len(tracks.position), at=at, views=shown))
    for name, folder in views.items():
        if options.frames is None:
            raise OptionError(f"--frames: {folder.name} has views and no markers; expected how many frames")
        held = [{"box": box, "motion": "fixed"} for box in boxes]
        fps = _rate(options, None, folder.name, console)
        found.append(_entry(options, name, None, held, fps, options.frames, views=folder))
    if not found:
        raise OptionError(
            f"{options.folder}: has no motion; expected markers (.c3d, .npz, .csv), or views of it"
        )
    return found


def _rate(options: InitOptions, known: float | None, of: str, console: Console) -> float:
    rate = options.fps if options.fps is not None else known
    if rate is not None:
        return rate
    try:
        return float(_asked(None, f"frames per second of {of}", "", console))
    except ValueError as error:
        raise OptionError(f"--fps: {of} does not say its rate; expected frames per second") from error


def _entry(
    options: InitOptions,
    name: str,
    tracks: MarkerFile | None,
    held: Sequence[Mapping[str, object]],
    fps: float,
    frames: int,
    *,
    at: np.ndarray | None = None,
    views: Path | None = None,
) -> dict[str, object]:
    fit = max(1, round(options.share * frames))
    return sequence_entry(
        name, tracks, fps=fps, frames=frames, fit=fit, held=held, at=at, sigma=options.sigma,
        release=options.release, views=None if views is None else views.name,
    )  # fmt: skip
