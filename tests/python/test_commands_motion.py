"""register, track and contact from end to end on a small video of a rod, and what is wrong with an input."""

import json
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest

import rod_video
from command_example import answer, call
from mphygs.capture.rotation import matrix_from_quaternion, matrix_from_rotation_vector
from mphygs.capture.transforms import read_transforms
from mphygs.commands import contact, register, track
from mphygs.motion import video_stages

MOTION = rod_video.RodMotion(start=((0.05, -0.1, 0.15), (0.004, -0.006, 0.005)))
PIXEL = 0.16 / rod_video.SIZE


@pytest.fixture(scope="module", autouse=True)
def _few_frames_without_cameras() -> Iterator[None]:
    """Cameras are left out in two frames rather than in six: that takes most of the time here."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(video_stages, "JACKKNIFED", 2)
        yield


@pytest.fixture(scope="module")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("rod") / "capture"
    rod_video.write_rod_capture(folder, MOTION)
    return folder


@pytest.fixture(scope="module")
def gaussians(capture: Path) -> Path:
    return capture.parent / "gaussians.ply"


def options(gaussians: Path, run: Path, *more: object) -> tuple[object, ...]:
    return ("--out", run, "--gaussians", gaussians, "--control-points", 50, *more)


@pytest.fixture(scope="module")
def run(capture: Path, gaussians: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run folder with all three stages."""
    folder = tmp_path_factory.mktemp("run")
    answer(contact.main, capture, *options(gaussians, folder, "--tracks", 120))
    return folder


def hand_points() -> tuple[np.ndarray, np.ndarray]:
    """Corners (8, 3) [m] of what is held, and where they are (T, 8, 3)."""
    sides = ((0.0, rod_video.HELD), (-0.008, 0.008), (-0.005, 0.005))
    corners = np.stack(np.meshgrid(*sides, indexing="ij"), axis=-1).reshape(-1, 3)
    poses = [MOTION.hand(frame) for frame in range(rod_video.FRAMES)]
    return corners, np.stack([corners @ rotation.T + shift for rotation, shift in poses])


def test_register(capture: Path, gaussians: Path, run: Path, tmp_path: Path) -> None:
    found = answer(register.main, capture, *options(gaussians, tmp_path))["sequences"]["carried"]
    assert found["by"] == "correspondences" and found["points_used"] >= 8
    rotation, shift = MOTION.hand(0)
    with np.load(tmp_path / "stages" / "register" / "carried" / "pose.npz") as pose:
        turn = matrix_from_quaternion(pose["quaternion"])
        refined, position = pose["refined"], pose["position"]
    corners, _ = hand_points()
    away = corners @ turn.T + position - (corners @ rotation.T + shift)
    assert np.linalg.norm(away, axis=1).max() < 0.5 * PIXEL
    rest = video_stages.read_gaussians(gaussians).positions.numpy()
    error = np.linalg.norm(refined - MOTION(rest, 0), axis=1)
    assert np.sqrt((error**2).mean()) < 0.25 * PIXEL
    assert np.linalg.norm(rest - MOTION(rest, 0), axis=1).mean() > 4 * PIXEL
    picture = cv2.imread(found["picture"])
    assert picture is not None and picture.std() > 20
    again = answer(register.main, capture, *options(gaussians, tmp_path))["sequences"]["carried"]
    assert "by" not in again, "what is there is not made again"
    code, out, _ = call(register.main, capture, *options(gaussians, tmp_path))
    assert code == 0 and "as it was" in out


def test_track(capture: Path, gaussians: Path, run: Path) -> None:
    found = answer(track.main, capture, *options(gaussians, run, "--tracks", 120))["sequences"]["carried"]
    assert found["tracks"] == 120 and found["frames"] == rod_video.FRAMES and found["seen"] > 0.9
    with np.load(found["file"]) as tracks:
        arrays = dict(tracks)
    truth = np.stack([MOTION(arrays["rest"], frame) for frame in range(rod_video.FRAMES)])
    error = arrays["position"] - truth
    assert np.sqrt(np.nanmean(error**2)) < 0.5 * PIXEL
    assert 0.4 < np.sqrt(np.nanmean((error / arrays["sigma"][:, None]) ** 2)) < 2.0
    assert cv2.imread(found["picture"]).std() > 5
    assert not (Path(found["file"]).parent / "begun").exists(), "nothing half made is left"


def test_contact(capture: Path, gaussians: Path, run: Path) -> None:
    found = answer(contact.main, capture, *options(gaussians, run, "--tracks", 120))["sequences"]["carried"]
    assert found["from"] == "made", "the fixture made it"
    with np.load(found["file"]) as hold:
        turn, position, box = matrix_from_quaternion(hold["quaternion"]), hold["position"], hold["box"]
    corners, truth = hand_points()
    away = np.linalg.norm(corners @ turn.transpose(0, 2, 1) + position[:, None] - truth, axis=2)
    assert np.sqrt((away**2).mean()) < PIXEL
    assert (box[0] < rod_video.CONTACT).all() and (box[1] > rod_video.CONTACT).all()
    assert box[1][0] < 2.0 * rod_video.HELD
    assert cv2.imread(found["picture"]).std() > 5


def test_a_run_that_is_interrupted_goes_on_with_the_same_numbers(
    capture: Path, gaussians: Path, run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Stopped after five frames, then while cameras are left out."""
    shutil.copytree(run / "stages" / "register", tmp_path / "stages" / "register")
    command = (capture, *options(gaussians, tmp_path, "--tracks", 120))
    read = video_stages.VideoRun.read

    def stopping(at: int) -> Callable[..., list]:
        def stops(self: video_stages.VideoRun, views: object, frame: int) -> list:
            if frame == at:
                raise KeyboardInterrupt
            return read(self, views, frame)

        return stops

    monkeypatch.setattr(video_stages.VideoRun, "read", stopping(6))
    code, out, err = call(track.main, *command)
    last = err.strip().splitlines()[-1]
    assert code == 130 and not out
    assert last.startswith("mphygs track: interrupted; continue with: mphygs track ")
    for word in (str(capture), str(tmp_path), "--control-points 50", "--tracks 120", str(gaussians)):
        assert word in last
    folder = tmp_path / "stages" / "track" / "carried"
    assert (folder / "begun" / "tracks.npz").is_file() and not (folder / "tracks.npz").exists()
    seen: list[int] = []

    def watched(self: video_stages.VideoRun, views: object, frame: int) -> list:
        seen.append(frame)
        return read(self, views, frame)

    monkeypatch.setattr(video_stages.VideoRun, "read", watched)
    answer(track.main, *command)
    assert 5 in seen and seen[:2] == [0, 5], "frames 1 to 4 are not followed again"
    with np.load(folder / "tracks.npz") as again, np.load(run / "stages/track/carried/tracks.npz") as whole:
        for name in whole.files:
            assert np.array_equal(again[name], whole[name], equal_nan=True), name


def test_another_option_makes_it_again(capture: Path, gaussians: Path, run: Path, tmp_path: Path) -> None:
    shutil.copytree(run, tmp_path / "run")
    other = ("--out", tmp_path / "run", "--gaussians", gaussians, "--control-points", 40)
    found = answer(register.main, capture, *other)["sequences"]["carried"]
    assert found["by"] == "correspondences"


def test_a_users_own_pose_tracks_and_hold_are_used(
    capture: Path, gaussians: Path, run: Path, tmp_path: Path
) -> None:
    """Put where a made one stands: nothing is made again, nothing of theirs is lost."""
    shutil.copytree(run, tmp_path / "run")
    stages = tmp_path / "run" / "stages"
    with np.load(stages / "track" / "carried" / "tracks.npz") as made:
        mine = {**made, "position": made["position"] + 0.01}
    np.savez(stages / "track" / "carried" / "tracks.npz", **mine)
    shutil.rmtree(stages / "register")
    command = options(gaussians, tmp_path / "run", "--tracks", 77)
    found = answer(track.main, capture, *command)["sequences"]["carried"]
    assert found["tracks"] == 120 and "difference" not in found
    assert not (stages / "register").exists(), "not needed"
    # the contact is found anew, from these tracks
    found = answer(contact.main, capture, *command, "--radius", 0.018)["sequences"]["carried"]
    assert found["from"] == "new" and found["held_tracks"] >= 6
    path = stages / "contact" / "carried" / "hold.npz"
    with np.load(path) as made:
        hold = {**made, "position": np.zeros((rod_video.FRAMES, 3))}
    np.savez(path, **hold)
    content = path.read_bytes()
    for more in ((), ("--radius", 0.02), ("--estimate",)):
        assert answer(contact.main, capture, *command, *more)["sequences"]["carried"]["from"] == "own"
        assert path.read_bytes() == content
    np.savez(path, **{**hold, "quaternion": hold["quaternion"][:5]})
    code, _, err = call(contact.main, capture, *command)
    assert code == 2 and "quaternion: has 5 frames; expected 8, as the sequence" in err
    pose = stages / "register" / "carried" / "pose.npz"
    pose.parent.mkdir(parents=True)
    np.savez(pose, quaternion=[1.0, 0, 0, 0], position=np.zeros(3), refined=np.zeros((7, 3)))
    code, _, err = call(register.main, capture, *command[:6])
    assert code == 2 and "refined: has 7 points; expected" in err and pose.is_file()


def test_the_captures_own_hold_is_handed_on(tmp_path: Path) -> None:
    folder = tmp_path / "held"
    gaussians = rod_video.write_rod_capture(folder, MOTION, views=2, held=True)
    run = tmp_path / "run"
    found = answer(contact.main, folder, "--out", run, "--gaussians", gaussians)["sequences"]["carried"]
    assert found["from"] == "capture"
    with np.load(folder / "hold.npz") as given, np.load(found["file"]) as kept:
        assert kept["position"] == pytest.approx(given["position"])
        assert kept["quaternion"] == pytest.approx(given["quaternion"])
    assert not (run / "stages" / "track").exists(), "nothing is followed for it"
    # the user's own replaces it and is not written over
    with np.load(found["file"]) as kept:
        mine = {**kept, "position": kept["position"] + 0.001}
    np.savez(found["file"], **mine)
    again = answer(contact.main, folder, "--out", run, "--gaussians", gaussians)["sequences"]["carried"]
    assert again["from"] == "own"
    with np.load(found["file"]) as kept:
        assert kept["position"] == pytest.approx(mine["position"])


VIDEO = Path("views") / "carried"


def edited(path: Path, change: Callable[[object], object]) -> None:
    document = json.loads(path.read_text())
    change(document)
    path.write_text(json.dumps(document))


def lacks_a_frame(folder: Path) -> None:
    edited(folder / VIDEO / "transforms.json", lambda d: d["frames"].pop(-2))


def lacks_a_picture(folder: Path) -> None:
    (folder / VIDEO / "images" / "camera2_003.png").unlink()


def one_camera(folder: Path) -> None:
    def change(document: dict) -> None:
        document["frames"] = [f for f in document["frames"] if "camera0" in f["file_path"]]

    edited(folder / VIDEO / "transforms.json", change)
    for name in ("contact.json", "correspondences.json"):
        (folder / VIDEO / name).unlink()


def small_mask(folder: Path) -> None:
    cv2.imwrite(str(folder / VIDEO / "masks" / "camera1_000.png"), np.full((40, 40), 255, np.uint8))


def empty_mask(folder: Path) -> None:
    empty = np.zeros((rod_video.SIZE, rod_video.SIZE), np.uint8)
    cv2.imwrite(str(folder / VIDEO / "masks" / "camera1_000.png"), empty)


def unknown_image(folder: Path) -> None:
    def change(document: list) -> None:
        document[4]["rest"]["restX"] = document[4]["rest"].pop("rest0")

    edited(folder / VIDEO / "correspondences.json", change)


def unknown_camera_of_the_contact(folder: Path) -> None:
    edited(folder / VIDEO / "contact.json", lambda d: d.update(camera9=d.pop("camera0")))


def wrong_pose(folder: Path) -> None:
    """camera1 is stated to look 8 degrees beside where it looked."""
    turn = np.eye(4)
    turn[:3, :3] = matrix_from_rotation_vector(np.radians([0.0, 8.0, 0.0]))

    def change(document: dict) -> None:
        for frame in document["frames"]:
            if "camera1" in frame["file_path"]:
                frame["transform_matrix"] = (np.array(frame["transform_matrix"]) @ turn).tolist()

    edited(folder / VIDEO / "transforms.json", change)


def points_on_a_line(folder: Path) -> None:
    edited(folder / VIDEO / "correspondences.json", lambda d: d.__setitem__(slice(None), [d[0]] * 5))


@pytest.mark.parametrize(
    ("break_it", "message"),
    [
        (lacks_a_frame, 'camera "camera2" has no frame 7; expected frames 0 to 7 of every camera, in step'),
        (lacks_a_picture, "camera2_003.png"),
        (one_camera, "has 1 camera; expected at least 2 that saw the motion"),
        (small_mask, "is 40 x 40 pixels; expected 80 x 80, as its picture"),
        (empty_mask, "the mask is empty; expected white where the object is seen"),
        (unknown_image, 'there is no view "restX"; expected one of rest0'),
        (unknown_camera_of_the_contact, 'there is no camera "camera9"; expected one of camera0'),
        (wrong_pose, 'camera "camera1" is '),
        (points_on_a_line, 'sequence "carried": 5 points do not fix a rotation'),
    ],
    ids=lambda value: getattr(value, "__name__", None),
)
def test_an_input_that_cannot_be_used_is_one_line(
    capture: Path, gaussians: Path, tmp_path: Path, break_it: Callable[[Path], None], message: str
) -> None:
    folder, run = tmp_path / "broken", tmp_path / "run"
    shutil.copytree(capture, folder)
    break_it(folder)
    kept = run / "stages" / "contact" / "other" / "hold.npz"
    kept.parent.mkdir(parents=True)
    kept.write_bytes(b"kept")
    code, out, err = call(register.main, folder, *options(gaussians, run))
    assert code == 2 and not out
    last = err.strip().splitlines()[-1]
    assert last.startswith("mphygs register: ") and message in last, err
    assert "Traceback" not in err and "unexpected" not in err
    assert kept.read_bytes() == b"kept" and not (run / "stages" / "register").exists()


def test_a_bad_picture_in_the_middle_loses_nothing(
    capture: Path, gaussians: Path, run: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "broken"
    shutil.copytree(capture, folder)
    shutil.copytree(run / "stages" / "register", tmp_path / "run" / "stages" / "register")
    picture = folder / VIDEO / "masks" / "camera1_006.png"
    # as long as before: the same video to the stages that are done
    picture.write_bytes(b"x" * len(picture.read_bytes()))
    command = (folder, *options(gaussians, tmp_path / "run", "--tracks", 120))
    code, _, err = call(track.main, *command)
    assert code == 2 and "camera1_006.png" in err.strip().splitlines()[-1]
    partial = tmp_path / "run" / "stages" / "track" / "carried" / "begun" / "tracks.npz"
    with np.load(partial) as kept:
        assert len(kept["position"]) == 5


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--sequences", "thrown"), "--sequences: "),
        (("--control-points", 3), "--control-points: got 3; expected at least 5"),
        (("--longest", 8), "--longest: got 8; expected at least 16"),
        (("--gaussians", "nowhere.ply"), "nowhere.ply: is not there; expected Gaussians of"),
        (("--tracks", 3), "--tracks: got 3; expected at least 20"),
    ],
)
def test_options_that_cannot_be_used(
    capture: Path, gaussians: Path, tmp_path: Path, arguments: tuple[object, ...], message: str
) -> None:
    given = {"--out": tmp_path / "run", "--gaussians": gaussians, **dict([arguments])}
    code, out, err = call(track.main, capture, *(word for pair in given.items() for word in pair))
    assert code == 2 and not out and message in err and err.count("\n") == 1
    assert not (tmp_path / "run").exists()


def test_a_radius_or_a_contact_that_says_nothing(
    capture: Path, gaussians: Path, run: Path, tmp_path: Path
) -> None:
    code, _, err = call(contact.main, capture, *options(gaussians, run, "--radius", 0.0))
    assert code == 2 and "--radius: got 0.0; expected a length above 0 m" in err
    code, _, err = call(contact.main, capture, *options(gaussians, run, "--tracks", 3))
    assert code == 2 and "--tracks: got 3; expected at least 20" in err
    before = (run / "stages" / "contact" / "carried" / "hold.npz").read_bytes()
    code, _, err = call(contact.main, capture, *options(gaussians, run, "--tracks", 120, "--radius", 1e-4))
    last = err.strip().splitlines()[-1]
    assert code == 2 and 'sequence "carried": 0 tracks within 0.0001 m of the contact' in last
    assert (run / "stages" / "contact" / "carried" / "hold.npz").read_bytes() == before
    folder = tmp_path / "capture"
    shutil.copytree(capture, folder)
    (folder / VIDEO / "contact.json").unlink()
    code, _, err = call(contact.main, folder, *options(gaussians, tmp_path / "run"))
    assert code == 2 and 'sequence "carried": says not where the object is held' in err


def test_the_wrong_pose_of_the_test_is_wrong(capture: Path, tmp_path: Path) -> None:
    folder = tmp_path / "broken"
    shutil.copytree(capture, folder)
    wrong_pose(folder)
    shots = {s.camera.name: s.camera for s in read_transforms(folder / VIDEO / "transforms.json")}
    true = {c.name: c for c in rod_video.cameras(4)}
    moved = {n: np.linalg.norm(shots[n].camera_from_world - true[n].camera_from_world) for n in shots}
    assert moved["camera1"] > 0.1 and max(moved[n] for n in moved if n != "camera1") < 1e-6
