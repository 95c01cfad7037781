"""Files of the stages that follow motions: a user's own are used and checked."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from mphygs.capture.errors import CaptureError
from mphygs.motion.stage_files import read_registered, read_stage_hold, read_tracks

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
        found = read_tracks(path, frames=FRAMES)
        assert found.sigma == pytest.approx(np.full(COUNT, 1e-4))
        assert np.isnan(found.position[2, 1]).all() and found.position[3, 1] == pytest.approx(np.ones(3))


def test_tracks_of_ones_own_need_no_gaussians(tmp_path: Path) -> None:
    path, arrays = tmp_path / "tracks.npz", tracks()
    np.savez(path, **{name: arrays[name] for name in ("rest", "position", "sigma")}, colour=np.ones(3))
    assert len(read_tracks(path, frames=FRAMES).rest) == COUNT


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda t: t.update(position=t["position"][:3]), r"position: has 3 frames; expected 4, as"),
        (lambda t: t.update(sigma=np.ones(2)), r"sigma: has shape \(2,\)"),
        (lambda t: t.update(sigma=-t["sigma"]), "sigma: is -0.0001; expected standard deviations above 0"),
        (lambda t: t.update(sigma=np.array(0.0)), "sigma: is 0; expected"),
        (lambda t: t.update(sigma=np.array(np.nan)), "sigma: is nan; expected"),
        (lambda t: t.update(rest=t["rest"][1:]), "position: has 5 tracks; expected 4, as rest"),
        (lambda t: t["rest"].__setitem__((1, 2), np.nan), r"rest: is NaN at \[1, 2\]"),
        (lambda t: t.pop("sigma"), 'array "sigma" is missing'),
    ],
)
def test_tracks_that_are_refused(tmp_path: Path, change: Callable[[dict], object], message: str) -> None:
    path, arrays = tmp_path / "tracks.npz", tracks()
    change(arrays)
    np.savez(path, **arrays)
    with pytest.raises(CaptureError, match=message) as caught:
        read_tracks(path, frames=FRAMES)
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
    with pytest.raises(CaptureError, match="quaternion: has length 1.1 in frame 0; expected unit"):
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
    assert read_stage_hold(path, frames=FRAMES).box[1] == pytest.approx(1.0)
    with pytest.raises(CaptureError, match="position: has 4 frames; expected 9, as the sequence"):
        read_stage_hold(path, frames=9)
    np.savez(path, **{**good, "box": good["box"][::-1]})
    with pytest.raises(CaptureError, match=r"box: is .*; expected \[lower corner, upper corner\]"):
        read_stage_hold(path, frames=FRAMES)
