"""Stages of an image capture: folders of files that are made once, kept, and may be a user's own."""

from __future__ import annotations

import json
import shutil
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from mphygs.capture.digest import digest_of
from mphygs.capture.errors import CaptureError
from mphygs.capture.json_values import plain
from mphygs.capture.written import replace_arrays, replace_file

NOTE = "made.json"
STAGES = "stages"


@dataclass(frozen=True)
class StageFolder:
    """Where the stages of one image capture stand, and what they hand on."""

    folder: Path

    @classmethod
    def of(cls, run: Path) -> StageFolder:
        """The one in the run folder `run`."""
        return cls(run / STAGES)

    @property
    def gaussians(self) -> Path:
        """The object at rest as Gaussians."""
        return self.folder / "rest" / "gaussians.ply"

    @property
    def features(self) -> Path:
        """What the Gaussians look like beyond colour."""
        return self.folder / "features" / "features.npz"

    @property
    def particles(self) -> Path:
        """The object's volume as particles."""
        return self.folder / "object" / "particles.npz"

    @property
    def parts(self) -> Path:
        """Folder of the segments' meshes."""
        return self.folder / "object" / "parts"

    def pose(self, sequence: str) -> Path:
        """Where a sequence begins."""
        return self.folder / "register" / sequence / "pose.npz"

    def tracks(self, sequence: str) -> Path:
        """Points followed through a sequence."""
        return self.folder / "track" / sequence / "tracks.npz"

    def hold(self, sequence: str) -> Path:
        """What moves the object in a sequence."""
        return self.folder / "contact" / sequence / "hold.npz"


@dataclass(frozen=True)
class Stage:
    """One stage. folder: it writes; files: that later stages need, also as patterns such as parts/*.ply;
    made_of: options and digests of what it was made from, as JSON knows them."""

    folder: Path
    files: tuple[str, ...]
    made_of: Mapping[str, object]

    @classmethod
    def of(cls, path: Path, made_of: Mapping[str, object], *extra_files: str) -> Stage:
        """The stage whose file stands at `path`; extra_files: of its files, by name or pattern."""
        return cls(path.parent, (path.name, *extra_files), plain(dict(made_of)))

    def also(self, **made_of: object) -> Stage:
        """The stage made of something more."""
        return replace(self, made_of={**self.made_of, **plain(made_of)})

    @property
    def begun(self) -> Stage:
        """What a stage of one file has kept of its work so far."""
        return replace(self, folder=self.folder / "begun")

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

    def write(self, arrays: Mapping[str, np.ndarray]) -> None:
        """All of a stage whose one file is an .npz.

        Broken off at any moment, nothing of another make is left that passes for this or for a user's own.
        """
        if not self.complete(*self.made_of):
            self.begin()
        replace_arrays(self.path(*self.files), arrays)
        self.finish()

    def forget(self) -> None:
        """Remove the folder."""
        shutil.rmtree(self.folder, ignore_errors=True)

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
