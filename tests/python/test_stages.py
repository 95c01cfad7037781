"""Stages: what is made is kept, what is broken off is made again, what is a user's own is used."""

import json
import os
import shutil
from pathlib import Path

import numpy as np
import pytest

from mphygs.capture.digest import digest_of
from mphygs.capture.errors import CaptureError
from mphygs.capture.stages import NOTE, Stage

FILES = ("a.txt", "parts/*.ply")
ONE = "pose.npz"
ARRAYS = {"position": np.arange(3.0)}


def stage(run: Path, **made_of: object) -> Stage:
    return Stage.of(run / "object" / FILES[0], made_of, *FILES[1:])


def of_arrays(run: Path, **made_of: object) -> Stage:
    return Stage.of(run / "register" / "a" / ONE, {"rule": {"levels": ((1, 2),)}, **made_of})


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
    with pytest.raises(CaptureError, match=r"a.txt is not of this program's making, and parts/\*.ply is not"):
        own.state()
    own.path("parts/mine.ply").write_text("ply")
    assert own.state() == "own"
    make(own)
    own.path("a.txt").write_text("changed by hand")
    assert own.state() == "own" and stage(tmp_path, seed=1).state() == "own"
    make(own)
    own.path("parts/third.ply").write_text("added by hand")
    assert own.state() == "own"


def test_a_result_of_the_same_make_is_taken(tmp_path: Path) -> None:
    first = of_arrays(tmp_path, seed=1)
    assert first.state() == "missing"
    first.write(ARRAYS)
    assert first.state() == "made" and of_arrays(tmp_path, seed=1).state() == "made"
    assert of_arrays(tmp_path, seed=2).state() == "missing" and first.also(pose="other").state() == "missing"
    with np.load(first.path(ONE)) as archive:
        assert archive["position"] == pytest.approx(ARRAYS["position"])
    assert sorted(p.name for p in first.folder.iterdir()) == sorted([ONE, NOTE]), "nothing half made is left"
    note = json.loads(first.path(NOTE).read_text())
    assert note["made_of"] == {"rule": {"levels": [[1, 2]]}, "seed": 1}


def test_a_result_that_the_user_replaced_is_the_users_own(tmp_path: Path) -> None:
    made = of_arrays(tmp_path, seed=1)
    made.write(ARRAYS)
    np.savez(made.path(ONE), position=np.ones(3))
    assert made.state() == "own" and of_arrays(tmp_path, seed=2).state() == "own"
    made.path(NOTE).write_text("not JSON")
    assert made.state() == "own"


def break_off(monkeypatch: pytest.MonkeyPatch, after: int) -> None:
    """Interrupted where, after so many files, another one would be put in its place."""
    replaced: list[str] = []
    whole = os.replace

    def stops(source: Path, target: Path) -> None:
        if len(replaced) == after:
            raise KeyboardInterrupt
        replaced.append(str(target))
        whole(source, target)

    monkeypatch.setattr("mphygs.capture.written.os.replace", stops)


@pytest.mark.parametrize("moment", range(3))
def test_broken_off_while_writing_nothing_old_passes_for_new(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, moment: int
) -> None:
    of_arrays(tmp_path, seed=1).write(ARRAYS)
    break_off(monkeypatch, moment)
    with pytest.raises(KeyboardInterrupt):
        of_arrays(tmp_path, seed=2).write({"position": np.full(3, 9.0)})
    monkeypatch.undo()
    assert of_arrays(tmp_path, seed=2).state() == "missing"
    assert of_arrays(tmp_path, seed=1).state() == ("missing" if moment else "made")
    of_arrays(tmp_path, seed=2).write(ARRAYS)
    assert of_arrays(tmp_path, seed=2).state() == "made"


@pytest.mark.parametrize("moment", range(2))
def test_what_is_done_so_far_is_kept_for_the_same_make(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, moment: int
) -> None:
    stage = of_arrays(tmp_path, seed=1)
    here = stage.begun
    assert not here.complete(*here.made_of)
    here.write({"position": np.zeros((2, 3))})
    break_off(monkeypatch, moment)
    with pytest.raises(KeyboardInterrupt):
        here.write({"position": np.ones((4, 3))})
    monkeypatch.undo()
    assert here.complete(*here.made_of), "broken off, the old or the new stands there"
    with np.load(here.path(ONE)) as archive:
        assert len(archive["position"]) == (4 if moment else 2)
    assert stage.state() == "missing", "it is not the result"
    other = of_arrays(tmp_path, seed=2).begun
    assert not other.complete(*other.made_of)
    other.write({"position": np.zeros((1, 3))})
    assert not here.complete(*here.made_of) and other.complete(*other.made_of)
    other.forget()
    assert list(stage.folder.iterdir()) == []


def test_digests_tell_contents_apart(tmp_path: Path) -> None:
    folder = tmp_path / "views"
    folder.mkdir()
    digests = []

    def changed(name: str, content: bytes) -> None:
        (folder / name).write_bytes(content)
        digests.append(digest_of(folder))
        assert digest_of(folder) == digests[-1]

    changed("transforms.json", b"{}")
    changed("transforms.json", b"[]")
    changed("a.png", b"12345")
    changed("a.png", b"12346")
    large = bytes(1 << 18)
    changed("a.mp4", large)
    changed("a.mp4", large[:-4] + b"1234")
    changed("a.mp4", b"1234" + large[4:])
    changed("points3D.bin", large)
    changed("points3D.bin", large[: 1 << 17] + b"1" + large[(1 << 17) + 1 :])
    (folder / "a.png").rename(folder / "b.png")
    digests.append(digest_of(folder))
    assert len(set(digests)) == len(digests)
    assert digest_of(shutil.copytree(folder, tmp_path / "copy")) == digests[-1], "a copy is the same"
    one = digest_of(folder / "b.png")
    (folder / "b.png").write_bytes(b"12347")
    assert len({one, digest_of(folder / "b.png"), digest_of(folder / "b.png", 2.0)}) == 3
