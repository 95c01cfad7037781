"""Folders that runs are written to: nothing is lost there but an older run's results."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

from mphygs.command import OptionError
from mphygs.fit.run import DOCUMENT, FORMAT, same_file
from mphygs.image_stages import FOLDER

# What other commands found with a run that stands there no more.
COMPARISON = "comparison.json"
STALE = (
    "diagnosis.json", "diagnosis-so-far.json", "steps.json", COMPARISON, "report.html",
    "missing-force.safetensors", "missing_force.py",
)  # fmt: skip
# Pictures that `compare` drew of it.
PICTURES = "pictures"


def claim(folder: Path, *, beside: Sequence[str] = (), alone: str | None = None) -> None:
    """Make sure that writing a run to a folder destroys nothing but an older run; nothing is changed.

    beside: names of folders by which a run that was not finished is known as well; alone: of a file by which
    it is where nothing else stands there. Raises OptionError.
    """
    _check_place(folder)
    if not folder.is_dir() or {item.name for item in folder.iterdir()} <= {alone}:
        return
    if (folder / DOCUMENT).is_file():
        known = _is_ours(folder / DOCUMENT)
    else:
        known = (folder / "capture" / "answer.json").is_file() or any(
            (folder / name).is_dir() for name in (FOLDER, *beside)
        )
    if not known:
        raise OptionError(
            f"--out {folder}: has files that are not a run's; expected a run folder, or a new one"
        )


def claim_capture(folder: Path) -> None:
    """The same for a capture that is made: over one that was made before, and over nothing else.

    Raises OptionError.
    """
    _check_place(folder)
    made = (folder / "answer.json").is_file() and not (folder / DOCUMENT).exists()
    if folder.is_dir() and any(folder.iterdir()) and not made:
        raise OptionError(f"--out {folder}: has files that were not made here; expected a new folder")


def clear(folder: Path, more: Sequence[str] = (), *, plugin: str | Path | None = None) -> None:
    """Take away what was found with the run before, which is not true of the one that is written now.

    plugin: the file of effects that the new run uses, which stays wherever it is.
    """
    for drawn in _drawn(folder):
        drawn.unlink(missing_ok=True)
    for name in (*STALE, *more):
        if plugin is None or not same_file(folder / name, plugin):
            (folder / name).unlink(missing_ok=True)


def _drawn(folder: Path) -> list[Path]:
    """Pictures and films that the comparison kept in a folder tells of, those inside it."""
    try:
        told = json.loads((folder / COMPARISON).read_text(encoding="utf-8"))
        names = [Path(path).name for key in ("pictures", "films") for path in told.get(key, ())]
    except (OSError, ValueError, TypeError, AttributeError):
        return []
    return [folder / PICTURES / name for name in names]


def _check_place(folder: Path) -> None:
    """Whether a folder may stand there at all."""
    if folder.exists() and not folder.is_dir():
        raise OptionError(f"--out {folder}: is a file; expected a folder")
    over = next((above for above in folder.parents if above.exists() and not above.is_dir()), None)
    if over is not None:
        raise OptionError(f"--out {folder}: {over} is a file; expected a folder")


def _is_ours(document: Path) -> bool:
    try:
        found = json.loads(document.read_text(encoding="utf-8"))
    except ValueError:
        return False
    return isinstance(found, dict) and found.get("format") == FORMAT
