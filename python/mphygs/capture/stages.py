"""Stages of an image capture: folders of files that are made once, kept, and may be a user's own."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from mphygs.capture.errors import CaptureError
from mphygs.capture.json_values import plain
from mphygs.capture.record import Capture
from mphygs.capture.written import replace_file

NOTE = "made.json"
STAGES = "stages"


@dataclass(frozen=True)
class Stage:
    """One stage. folder: it writes; files: that later stages need, also as patterns such as parts/*.ply;
    made_of: options and digests of what it was made from, as JSON knows them."""

    folder: Path
    files: tuple[str, ...]
    made_of: Mapping[str, object]

    @classmethod
    def of(cls, run: Path, name: str, files: tuple[str, ...], made_of: Mapping[str, object]) -> Stage:
        """The stage `name` in the run folder `run`."""
        return cls(run / STAGES / name, files, plain(dict(made_of)))

    def path(self, name: str) -> Path:
        """A file of the stage."""
        return self.folder / name

    def present(self) -> dict[str, Path]:
        """The files that are there, by their name relative to the folder."""
        found = [path for pattern in self.files for path in sorted(self.folder.glob(pattern))]
        return {path.relative_to(self.folder).as_posix(): path for path in found if path.is_file()}

    def state(self) -> str:
        """One of three words: "made", with the same options; "own", files of a user or changed by one;
        "missing", still to be made, which files made with other options are as well.

        Raises CaptureError where some files are a user's own and others are not there.
        """
        note = self._note()
        if note and note.get("unfinished"):
            return "missing"
        digests = note.get("files", {}) if note else {}
        there = self.present()
        own = [name for name, path in there.items() if digests.get(name) != digest_of(path)]
        lacking = [pattern for pattern in self.files if not any(self.folder.glob(pattern))]
        if not own:
            same = note is not None and note.get("made_of") == self.made_of
            return "made" if same and not lacking and there.keys() == digests.keys() else "missing"
        if lacking:
            raise CaptureError(
                f"{self.folder}: {own[0]} is not of this program's making, and {', '.join(lacking)} is not "
                "there; expected all of them, or none"
            )
        return "own"

    def complete(self, *same: str) -> bool:
        """Whether all files are there and finished, and `same` of what they were made of is as now."""
        note = self._note()
        if (note and note.get("unfinished")) or not all(any(self.folder.glob(f)) for f in self.files):
            return False
        before = (note or {}).get("made_of") or {}
        return all(before.get(name) == self.made_of[name] for name in same)

    def begin(self) -> None:
        """Make the folder, and forget what was made in it before."""
        self.folder.mkdir(parents=True, exist_ok=True)
        # what is written before finish() is called is not taken for a user's own
        self._write({"unfinished": True})
        for path in self.present().values():
            path.unlink()

    def finish(self) -> None:
        """Note what the files were made of, once all are written."""
        digests = {name: digest_of(path) for name, path in self.present().items()}
        self._write({"made_of": self.made_of, "files": digests})

    def _write(self, note: Mapping[str, object]) -> None:
        replace_file(self.folder / NOTE, json.dumps(note, indent=1) + "\n")

    def _note(self) -> dict | None:
        path = self.folder / NOTE
        if not path.is_file():
            return None
        try:
            note = json.loads(path.read_text(encoding="utf-8"))
        except ValueError:
            return None
        return note if isinstance(note, dict) else None


def digest_of(path: Path) -> str:
    """SHA-256 of a file."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def folder_digest(folder: Path) -> str:
    """SHA-256 of names and sizes of all files in a folder, and of the content of its .json and text files.

    Pictures are told by name, size and time of change: reading all of them takes longer than most stages.
    """
    found = hashlib.sha256()
    for path in sorted(p for p in folder.rglob("*") if p.is_file()):
        stat = path.stat()
        found.update(f"{path.relative_to(folder)} {stat.st_size}".encode())
        if path.suffix in (".json", ".txt"):
            found.update(path.read_bytes())
        else:
            found.update(str(stat.st_mtime_ns).encode())
    return found.hexdigest()


def views_digest(capture: Capture) -> str:
    """The same for the rest views of a capture, in metres."""
    return _in_metres(folder_digest(capture.views), capture.views_scale)


def gaussians_digest(capture: Capture) -> str:
    """The same for the Gaussians of a capture, in metres."""
    return _in_metres(digest_of(capture.gaussians), capture.gaussians_scale)


def _in_metres(digest: str, scale: float) -> str:
    return digest if scale == 1.0 else f"{digest} x {scale!r}"
