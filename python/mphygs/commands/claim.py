"""Folders and files that are written to: nothing is lost there but this program's older results."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

from mphygs.capture.folder_mark import is_marked
from mphygs.capture.stages import STAGES
from mphygs.commands.in_use import hold
from mphygs.commands.options import OptionError
from mphygs.fit.run import DOCUMENT, FORMAT, TRAINED, same_file

# What other commands found with a run that stands there no more.
COMPARISON = "comparison.json"
STALE = (
    "diagnosis.json", "diagnosis-so-far.json", "steps.json", COMPARISON, "report.html",
    "missing-force.safetensors", "missing_force.py", TRAINED,
)  # fmt: skip
# What is in them, by which they are known: keys of a document, the beginning of a file and words in its head.
_KEYS = {
    DOCUMENT: ("format",),
    "diagnosis.json": ("verdict", "ranking"),
    "diagnosis-so-far.json": ("steps", "states"),
    "steps.json": ("steps",),
    COMPARISON: ("sequences", "adequate"),
    "batch.json": ("format", "order"),
}
_HEADS = {
    ".html": (b"<!doctype html>", b"<title>mphygs: "),
    ".safetensors": (b"", b"mphygs"),
    ".py": (b'"""', b"as an effect of the model."),
    ".csv": (b"run,folder,seed,", b""),
}
_HEAD = 4096  # bytes
# Pictures that `compare` drew of it.
PICTURES = "pictures"


def claim(
    folder: Path, *, inner_runs: Sequence[str] = (), alone: str | None = None, plugin: Path | None = None
) -> None:
    """Hold a folder for a run, sure that writing it destroys nothing but an older run's results.

    A folder is taken that is new or empty, or that carries this program's mark: a file that says so, an older
    run's document, or that of a command that was broken off. Stages may be there, which may be a user's own,
    and folders that carry the mark themselves.
    inner_runs: names of folders with a run of their own by which one that was not finished is known as well;
    alone: of a file of steps by which it is where nothing else stands there; plugin: the file of effects that
    the new run uses, which stays. Raises OptionError; HeldError where another command writes there.
    """
    _check_place(folder)
    if folder.is_dir():
        found = {i.name for i in folder.iterdir() if i.name != STAGES and not is_marked(i)}
        known = (
            is_marked(folder)
            or any(_is_run(folder / name / DOCUMENT) for name in (".", *inner_runs))
            or not found
            or (found == {alone} and is_own_file(folder / alone))
        )
        if not known:
            raise OptionError(
                f"--out {folder}: has files that are not a run's; expected a run folder, or a new one"
            )
        for name in (DOCUMENT, *STALE):
            if plugin is None or not same_file(folder / name, plugin):
                _check_written(folder / name)
    hold(folder)


def claim_capture(folder: Path) -> None:
    """The same for a capture that is made: over one that was made before, and over nothing else."""
    claim_output(folder)
    if (folder / DOCUMENT).exists():
        raise OptionError(f"--out {folder}: holds a run; expected a new folder")


def claim_output(folder: Path) -> None:
    """The same for a folder of files of any other kind: new, empty, or one that was written to before."""
    _check_place(folder)
    if folder.is_dir() and any(folder.iterdir()) and not is_marked(folder):
        raise OptionError(f"--out {folder}: has files that were not made here; expected a new folder")
    hold(folder)


def claim_file(path: Path) -> None:
    """Make sure that a file may be written: that of another kind is not replaced. Raises OptionError."""
    _check_place(path.parent)
    if path.is_dir():
        raise OptionError(f"--out {path}: is a folder; expected the name of a file")
    _check_written(path)
    path.parent.mkdir(parents=True, exist_ok=True)


def folder_inside(run: Path, name: str) -> Path:
    """The folder `name` of a run, made. Raises OptionError where it is a link that leads elsewhere."""
    folder = run / name
    if folder.resolve().parent != run.resolve():
        raise OptionError(f"{folder}: leads out of the run folder; expected a folder in it")
    _check_place(folder)
    folder.mkdir(exist_ok=True)
    return folder


def clear(folder: Path, extra_files: Sequence[str] = (), *, plugin: str | Path | None = None) -> None:
    """Take away what was found with the run before, which is not true of the one that is written now.

    extra_files: in it, that are taken away as well; plugin: the file of effects that the new run uses, which
    stays wherever it is.
    """
    for drawn in _drawn(folder):
        drawn.unlink(missing_ok=True)
    for name in (*STALE, *extra_files):
        if plugin is None or not same_file(folder / name, plugin):
            (folder / name).unlink(missing_ok=True)


def _drawn(folder: Path) -> list[Path]:
    """Pictures and films that the comparison kept in a folder tells of, those inside it."""
    try:
        told = json.loads((folder / COMPARISON).read_text(encoding="utf-8"))
        paths = [Path(path) for key in ("pictures", "films") for path in told.get(key, ())]
    except (OSError, ValueError, TypeError, AttributeError, RecursionError):
        return []
    return [folder / PICTURES / path.name for path in paths if path.suffix in (".png", ".mp4")]


def _check_place(folder: Path) -> None:
    """Whether a folder may stand there at all."""
    if folder.exists() and not folder.is_dir():
        raise OptionError(f"--out {folder}: is a file; expected a folder")
    over = next((above for above in folder.parents if above.exists() and not above.is_dir()), None)
    if over is not None:
        raise OptionError(f"--out {folder}: {over} is a file; expected a folder")


def is_own_file(path: Path) -> bool:
    """Whether a file is one that this program writes under its name: told by what is in it."""
    keys = _KEYS.get(path.name)
    try:
        if keys is not None:
            found = json.loads(path.read_text(encoding="utf-8"))
            return isinstance(found, dict) and all(key in found for key in keys)
        with path.open("rb") as stream:
            head = stream.read(_HEAD)
    except (OSError, ValueError, RecursionError):
        return False
    begin, words = _HEADS.get(path.suffix, (b"", b""))
    return head.startswith(begin) and words in head


def _check_written(path: Path) -> None:
    """Raises OptionError for a file of another's making."""
    if path.is_symlink() or (path.exists() and not is_own_file(path)):
        raise OptionError(
            f"{path}: was not made here, and would be replaced; expected it elsewhere, or another folder"
        )


def _is_run(document: Path) -> bool:
    try:
        found = json.loads(document.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return False
    return isinstance(found, dict) and found.get("format") == FORMAT
