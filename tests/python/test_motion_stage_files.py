"""Files of the stages that follow motions: made once, broken off safely, a user's own used and checked."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from mphygs.capture.errors import CaptureError
from mphygs.motion import stage_files
from mphygs.motion.stage_files import (
    RECORD,
    MotionStage,
    digest_of_files,
    read_hold,
    read_registered,
    read_tracks,
)

NAME = "pose.npz"
ARRAYS = {"position": np.arange(3.0)}


def stage(folder: Path, **made_of: object) -> MotionStage:
    return MotionStage(folder / "register" / "a", {"rule": {"levels": ((1, 2),)}, **made_of})


def test_a_result_of_the_same_make_is_taken(tmp_path: Path) -> None:
    first = stage(tmp_path, seed=1)
    assert not first.holds(NAME) and not first.is_given(NAME)
    first.write(NAME, ARRAYS)
    assert first.holds(NAME) and stage(tmp_path, seed=1).holds(NAME) and not first.is_given(NAME)
    assert not stage(tmp_path, seed=2).holds(NAME) and not first.of(pose="other").holds(NAME)
    with np.load(first.folder / NAME) as archive:
        assert archive["position"] == pytest.approx(ARRAYS["position"])
    assert sorted(p.name for p in first.folder.iterdir()) == [NAME, RECORD], "nothing half made is left"


def test_a_users_own_is_taken_whatever_the_make(tmp_path: Path) -> None:
    own = stage(tmp_path, seed=1)
    own.folder.mkdir(parents=True)
    np.savez(own.folder / NAME, position=np.ones(3))
    assert own.is_given(NAME) and own.holds(NAME) and stage(tmp_path, seed=2).holds(NAME)


def test_a_result_that_the_user_replaced_is_the_users_own(tmp_path: Path) -> None:
    made = stage(tmp_path, seed=1)
    made.write(NAME, ARRAYS)
    np.savez(made.folder / NAME, position=np.ones(3))
    assert made.is_given(NAME) and stage(tmp_path, seed=2).holds(NAME)
    (made.folder / RECORD).write_text("not JSON")
    assert made.is_given(NAME)


@pytest.mark.parametrize("moment", range(2))
def test_broken_off_while_writing_nothing_old_passes_for_new(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, moment: int
) -> None:
    stage(tmp_path, seed=1).write(NAME, ARRAYS)
    replaced: list[str] = []
    whole = stage_files.os.replace

    def stops(source: Path, target: Path) -> None:
        if len(replaced) == moment:
            raise KeyboardInterrupt
        replaced.append(str(target))
        whole(source, target)

    monkeypatch.setattr(stage_files.os, "replace", stops)
    with pytest.raises(KeyboardInterrupt):
        stage(tmp_path, seed=2).write(NAME, {"position": np.full(3, 9.0)})
    monkeypatch.undo()
    for seed in (1, 2):
        assert not stage(tmp_path, seed=seed).holds(NAME) and not stage(tmp_path, seed=seed).is_given(NAME)
    stage(tmp_path, seed=2).write(NAME, ARRAYS)
    assert stage(tmp_path, seed=2).holds(NAME)


def test_what_is_done_so_far_is_kept_for_the_same_make(tmp_path: Path) -> None:
    shapes = {"position": (None, 3)}
    here = stage(tmp_path, seed=1)
    assert here.partial(shapes) is None
    here.keep_partial({"position": np.zeros((2, 3))})
    here.keep_partial({"position": np.ones((4, 3))})
    assert here.partial(shapes)["position"] == pytest.approx(np.ones((4, 3)))
    assert not here.holds(NAME), "it is not the result"
    other = stage(tmp_path, seed=2)
    assert other.partial(shapes) is None
    other.keep_partial({"position": np.zeros((1, 3))})
    assert here.partial(shapes) is None and len(other.partial(shapes)["position"]) == 1
    other.drop_partial()
    assert list(here.folder.iterdir()) == []


def test_digests_tell_files_apart(tmp_path: Path) -> None:
    folder = tmp_path / "views"
    folder.mkdir()
    (folder / "a.png").write_bytes(b"12345")
    (folder / "transforms.json").write_text("{}")
    before = digest_of_files(folder)
    assert before == digest_of_files(folder)
    (folder / "transforms.json").write_text("[]")
    text = digest_of_files(folder)
    (folder / "a.png").write_bytes(b"123456")
    assert len({before, text, digest_of_files(folder)}) == 3
    file = tmp_path / "gaussians.ply"
    file.write_bytes(b"1")
    one = digest_of_files(file)
    file.write_bytes(b"2")
    assert digest_of_files(file) != one


FRAMES, COUNT = 4, 5
TURN = np.array([1.0, 0.0, 0.0, 0.0])


def tracks() -> dict[str, np.ndarray]:
    position = np.ones((FRAMES, COUNT, 3))
    position[2, 1] = np.nan
    return {
        "rest": np.zeros((COUNT, 3)), "position": position, "quaternion": np.tile(TURN, (FRAMES, COUNT, 1)),
        "sigma": np.full(COUNT, 1e-4), "gaussian": np.arange(COUNT),
    }  # fmt: skip


def test_tracks_are_read_with_one_sigma_or_many(tmp_path: Path) -> None:
    path = tmp_path / "tracks.npz"
    for sigma in (np.full(COUNT, 1e-4), np.array(1e-4)):
        np.savez(path, **{**tracks(), "sigma": sigma})
        found = read_tracks(path, frames=FRAMES, gaussians=COUNT)
        assert found.sigma == pytest.approx(np.full(COUNT, 1e-4))
        assert np.isnan(found.position[2, 1]).all() and found.gaussian.dtype == np.int64


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda t: t.update(position=t["position"][:3]), r"position: has 3 frames; expected 4, as"),
        (lambda t: t.update(sigma=np.ones(2)), r"sigma: has shape \(2,\)"),
        (lambda t: t.update(sigma=-t["sigma"]), "sigma: is -0.0001; expected standard deviations above 0"),
        (lambda t: t.update(sigma=np.array(0.0)), "sigma: is 0; expected"),
        (lambda t: t.update(gaussian=t["gaussian"] + 1), "gaussian: names rows that there are not.* 0 to 4"),
        (lambda t: t.update(gaussian=t["gaussian"] + 0.5), "gaussian: names rows"),
        (lambda t: t["rest"].__setitem__((1, 2), np.nan), r"rest: is NaN at \[1, 2\]"),
        (lambda t: t.pop("quaternion"), 'array "quaternion" is missing'),
        (lambda t: t.update(colour=np.ones(3)), "colour: unknown array"),
    ],
)
def test_tracks_that_are_refused(tmp_path: Path, change: Callable[[dict], object], message: str) -> None:
    path, arrays = tmp_path / "tracks.npz", tracks()
    change(arrays)
    np.savez(path, **arrays)
    with pytest.raises(CaptureError, match=message) as caught:
        read_tracks(path, frames=FRAMES, gaussians=COUNT)
    assert str(caught.value).startswith(str(path)) and "\n" not in str(caught.value)


def test_poses_are_checked(tmp_path: Path) -> None:
    path = tmp_path / "pose.npz"
    good = {"quaternion": TURN * (1 + 1e-5), "position": np.zeros(3), "refined": np.zeros((COUNT, 3))}
    np.savez(path, **good)
    found = read_registered(path, gaussians=COUNT)
    assert np.linalg.norm(found.quaternion) == pytest.approx(1.0, abs=1e-12)
    assert found.rotation == pytest.approx(np.eye(3))
    with pytest.raises(CaptureError, match="refined: has 5 points; expected 7, as gaussians.ply"):
        read_registered(path, gaussians=7)
    np.savez(path, **{**good, "quaternion": 1.1 * TURN})
    with pytest.raises(CaptureError, match="quaternion: has a length 0.1 off 1; expected unit"):
        read_registered(path, gaussians=COUNT)
    path.write_bytes(b"no archive")
    with pytest.raises(CaptureError, match="pose.npz: is not an .npz file"):
        read_registered(path, gaussians=COUNT)


def test_holds_are_checked(tmp_path: Path) -> None:
    path = tmp_path / "hold.npz"
    good = {
        "position": np.zeros((FRAMES, 3)), "quaternion": np.tile(TURN, (FRAMES, 1)),
        "box": np.array([[0.0, 0.0, 0.0], [1.0, 1.0, 1.0]]),
    }  # fmt: skip
    np.savez(path, **good)
    assert read_hold(path, frames=FRAMES).box[1] == pytest.approx(1.0)
    with pytest.raises(CaptureError, match="position: has 4 frames; expected 9, as the sequence"):
        read_hold(path, frames=9)
    np.savez(path, **{**good, "box": good["box"][::-1]})
    with pytest.raises(CaptureError, match="expected a lower corner below an upper one"):
        read_hold(path, frames=FRAMES)


def test_the_record_says_what_a_result_was_made_of(tmp_path: Path) -> None:
    made = stage(tmp_path, seed=1)
    made.write(NAME, ARRAYS)
    record = json.loads((made.folder / RECORD).read_text())
    assert record["made_of"] == {"rule": {"levels": [[1, 2]]}, "seed": 1}
