"""Stages: what is made is kept, what is broken off is made again, what is a user's own is used."""

from pathlib import Path

import pytest

from mphygs.capture.stages import Stage, folder_digest
from mphygs.commands.options import OptionError

FILES = ("a.txt", "parts/*.ply")


def stage(run: Path, **made_of: object) -> Stage:
    return Stage.of(run, "object", FILES, made_of)


def make(made: Stage) -> None:
    made.begin()
    made.path("a.txt").write_text("a")
    made.path("parts").mkdir(exist_ok=True)
    for name in ("one.ply", "two.ply"):
        made.path(f"parts/{name}").write_text(name)
    made.finish()


def test_what_is_made_is_kept_for_the_same_options(tmp_path: Path) -> None:
    first = stage(tmp_path, seed=0)
    assert first.state() == "missing" and not first.complete()
    make(first)
    assert first.state() == "made" and stage(tmp_path, seed=0).state() == "made"
    assert stage(tmp_path, seed=1).state() == "missing" and stage(tmp_path, seed=1).complete()
    assert stage(tmp_path, seed=0, more=2).complete("seed")
    assert not stage(tmp_path, seed=1).complete("seed")
    first.path("parts/two.ply").unlink()
    assert first.state() == "missing", "a file that was made is gone"


def test_what_was_broken_off_is_made_again(tmp_path: Path) -> None:
    broken = stage(tmp_path, seed=0)
    broken.begin()
    broken.path("a.txt").write_text("half")
    assert broken.state() == "missing" and not broken.complete()
    make(broken)
    broken.begin()
    assert not broken.path("a.txt").exists() and broken.state() == "missing"


def test_a_users_own_files_are_used(tmp_path: Path) -> None:
    own = stage(tmp_path, seed=0)
    own.path("parts").mkdir(parents=True)
    own.path("a.txt").write_text("mine")
    with pytest.raises(OptionError, match=r"a.txt is not of this program's making, and parts/\*.ply is not"):
        own.state()
    own.path("parts/mine.ply").write_text("ply")
    assert own.state() == "own"
    make(own)
    own.path("a.txt").write_text("changed by hand")
    assert own.state() == "own" and stage(tmp_path, seed=1).state() == "own"
    make(own)
    own.path("parts/third.ply").write_text("added by hand")
    assert own.state() == "own"


def test_a_folder_that_changes_has_another_digest(tmp_path: Path) -> None:
    (tmp_path / "transforms.json").write_text("{}")
    before = folder_digest(tmp_path)
    assert folder_digest(tmp_path) == before
    (tmp_path / "transforms.json").write_text("[]")
    changed = folder_digest(tmp_path)
    (tmp_path / "image.png").write_bytes(b"x")
    assert len({before, changed, folder_digest(tmp_path)}) == 3
