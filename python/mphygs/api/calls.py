"""An action of a command called from Python: its options, its progress, its errors, its run folder."""

from __future__ import annotations

import shutil
import tempfile
import weakref
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from io import StringIO
from pathlib import Path
from typing import Any, Literal, Protocol, TypeVar, get_args, get_origin, get_type_hints

from mphygs.api.interface_errors import InputError, as_interface_errors
from mphygs.capture.format import Capture, load_capture, save_capture
from mphygs.capture.json_values import plain
from mphygs.commands.claim import claim, claim_capture
from mphygs.commands.command import working
from mphygs.commands.console import Console
from mphygs.commands.options import CommonOptions
from mphygs.fit.run import capture_digest

# Told the share of the work that is done, 0 to 1, and a line.
Progress = Callable[[float, str], None]


class Home:
    """A temporary folder that goes with the last result that stands in it."""

    def __init__(self) -> None:
        self.path = Path(tempfile.mkdtemp(prefix="mphygs-"))
        weakref.finalize(self, shutil.rmtree, self.path, ignore_errors=True)


class HasRun(Protocol):
    """A result with a run folder."""

    @property
    def run(self) -> Path:
        """The folder."""
        ...


RunLike = str | Path | HasRun
CaptureLike = str | Path | Capture
Options = TypeVar("Options", bound=CommonOptions)
Found = TypeVar("Found")


@dataclass
class Told(Console):
    """A console that tells a callback instead of a stream."""

    listener: Progress | None = None
    share: float = field(default=0.0, init=False)

    def say(self, text: str) -> None:
        """One line, at the share that is done."""
        if self.listener is not None:
            self.listener(self.share, text)

    def progress(self, share: float, text: str) -> None:
        """One line, and the share that is done."""
        self.share = min(share, 1.0)
        self.say(text)


def call(action: Callable[[Options, Console], Found], options: Options, progress: Progress | None) -> Found:
    """What an action of a command finds. Raises MphygsError with the line that the command would end in."""
    _check_choices(options)
    with as_interface_errors(), working(options):
        return action(options, Told(StringIO(), listener=progress))


def _check_choices(options: CommonOptions) -> None:
    """Raises InputError for an option that is none of those there are: no line was read that would say so."""
    for name, hint in get_type_hints(type(options)).items():
        choices = [c for h in (hint, *get_args(hint)) if get_origin(h) is Literal for c in get_args(h)]
        value = getattr(options, name)
        if choices and value is not None and value not in choices:
            raise InputError(f"--{name}: got '{value}'; expected one of {', '.join(choices)}")


def json_of(document: object) -> dict[str, Any]:
    """A document as the command's JSON has it."""
    found = plain(document)
    assert isinstance(found, dict)
    return found


def comma(names: Sequence[str] | str) -> str | None:
    """Names as an option has them, None for none."""
    return (names if isinstance(names, str) else ",".join(names)) or None


def folder_of(run: RunLike) -> Path:
    """The run folder that a path or a result stands for."""
    return Path(run) if isinstance(run, (str, Path)) else run.run


def home_of(run: object) -> Home | None:
    """What keeps a result's folder, where it is one that goes with it."""
    return getattr(run, "_home", None)


def place(out: str | Path | None) -> tuple[Path, Home | None]:
    """The run folder of a call, and what keeps it: one of its own where none is named."""
    if out is not None:
        return Path(out), None
    home = Home()
    return home.path / "run", home


def placed_capture(
    capture: CaptureLike | None, out: Path, *, resume: bool = False, inner_runs: Sequence[str] = ()
) -> Path | None:
    """The folder of a capture. One that stands in no folder as it is, is written into the run's.

    inner_runs: see `claim`. To be called within an action.
    """
    if capture is None or isinstance(capture, (str, Path)):
        return None if capture is None else Path(capture)
    if is_kept(capture):
        return capture.folder
    folder = out / "capture"
    if not resume:
        claim(out, inner_runs=inner_runs)
        claim_capture(folder)
    save_capture(replace(capture, folder=folder), folder)
    return folder


def is_kept(capture: Capture) -> bool:
    """Whether a capture's folder holds it as it is."""
    if not (capture.folder / "capture.json").is_file():
        return False
    kept = load_capture(capture.folder)
    views = [
        (
            c.gaussians, c.gaussians_scale, c.views, c.views_scale,
            *((s.views, s.views_scale) for s in c.sequences),
        )
        for c in (kept, capture)
    ]
    return views[0] == views[1] and capture_digest(kept) == capture_digest(capture)
