"""What a hand holds and how it moves: closed forms, and tracks of a rod carried by one end."""

from dataclasses import replace

import numpy as np
import pytest

import rod_video
from mphygs.capture.errors import CaptureError
from mphygs.capture.rotation import matrix_from_quaternion, matrix_from_rotation_vector
from mphygs.motion.contact_motion import ContactWeights, coarse_contact, fit_contact
from mphygs.motion.grip import CORE, contact_at_rest, find_grip

FRAMES = 9
AT = np.array([0.02, 0.0, 0.01])


def motion(frames: int = FRAMES) -> tuple[np.ndarray, np.ndarray]:
    """Turns (T, 3, 3) and shifts (T, 3) [m] that go on evenly: no second difference."""
    steps = np.arange(frames)[:, None]
    turn = matrix_from_rotation_vector(steps * np.array([0.0, 0.02, 0.05]))
    place = AT + steps * np.array([1e-3, 0.0, -2e-3])
    return turn, place - turn @ AT


def carried(rest: np.ndarray, turn: np.ndarray, shift: np.ndarray) -> np.ndarray:
    return rest @ turn.transpose(0, 2, 1) + shift[:, None]


def cloud(count: int = 20) -> np.ndarray:
    return AT + np.random.default_rng(0).uniform(-0.01, 0.01, (count, 3))


def test_the_contact_is_recovered_exactly() -> None:
    rest, (turn, shift) = cloud(), motion()
    coarse = AT @ turn.transpose(0, 2, 1) + shift
    found = fit_contact(rest, carried(rest, turn, shift), coarse, AT, weights=ContactWeights(turn=0.0))
    assert found.turn == pytest.approx(turn, abs=1e-9)
    assert found.position == pytest.approx(shift, abs=1e-10)
    assert found.place == pytest.approx(coarse, abs=1e-10)
    assert matrix_from_quaternion(found.quaternion) == pytest.approx(turn, abs=1e-9)
    assert (np.sum(found.quaternion[1:] * found.quaternion[:-1], axis=1) > 0).all()
    assert np.nanmax(found.residual) < 1e-9


def test_the_smoothness_of_the_turn_hardly_pulls() -> None:
    rest, (turn, shift) = cloud(), motion()
    coarse = AT @ turn.transpose(0, 2, 1) + shift
    found = fit_contact(rest, carried(rest, turn, shift), coarse, AT)
    assert np.abs(found.turn - turn).max() < 1e-4


def test_frames_in_which_few_tracks_are_seen() -> None:
    rest, (turn, shift) = cloud(), motion()
    tracks = carried(rest, turn, shift)
    tracks[4, 5:] = np.nan
    coarse = np.full((FRAMES, 3), np.nan)
    coarse[0] = AT
    found = fit_contact(rest, tracks, coarse, AT, weights=ContactWeights(turn=0.0))
    assert found.position == pytest.approx(shift, abs=1e-9)
    assert np.isnan(found.residual[4, 5:]).all() and np.isfinite(found.residual[3]).all()
    tracks[4, 2:] = np.nan
    with pytest.raises(ValueError, match="frame 4: 2 of 20 tracks about the contact are seen; expected"):
        fit_contact(rest, tracks, coarse, AT)
    with pytest.raises(ValueError, match="of at least 6"):
        fit_contact(rest[:5], carried(rest[:5], turn, shift), coarse, AT)


def test_the_cost_falls_and_is_the_stated_one() -> None:
    rest, (turn, shift) = cloud(), motion()
    draw = np.random.default_rng(1)
    tracks = carried(rest, turn, shift) + 1e-3 * draw.standard_normal((FRAMES, len(rest), 3))
    coarse = AT @ turn.transpose(0, 2, 1) + shift + 1e-3 * draw.standard_normal((FRAMES, 3))
    weights = ContactWeights(coarse=2.0, tracks=0.5, place=3.0, turn=0.02)
    found = fit_contact(rest, tracks, coarse, AT, weights=weights)
    assert (np.diff(found.costs) <= 1e-15).all() and len(found.costs) > 1

    def cost(place: np.ndarray, turned: np.ndarray, quaternion: np.ndarray) -> float:
        off = place[:, None] + (rest - AT) @ turned.transpose(0, 2, 1) - tracks
        return 0.5 * (
            2.0 * ((place - coarse) ** 2).sum()
            + 0.5 * (off**2).sum()
            + 3.0 * (np.diff(place, 2, axis=0) ** 2).sum()
            + 0.02 * (np.diff(quaternion, 2, axis=0) ** 2).sum()
        )

    least = cost(found.place, found.turn, found.quaternion)
    assert found.costs[-1] == pytest.approx(least, rel=1e-9)
    # a minimum: no small change of one frame makes it less
    for frame in (0, 4, FRAMES - 1):
        for axis in range(3):
            moved = found.place.copy()
            moved[frame, axis] += 1e-5
            assert cost(moved, found.turn, found.quaternion) > least
            step = np.zeros((FRAMES, 3))
            step[frame, axis] = 1e-3
            turned = replace(found, turn=matrix_from_rotation_vector(step) @ found.turn)
            assert cost(found.place, turned.turn, turned.quaternion) > least


def test_pixels_of_two_cameras_place_the_contact() -> None:
    seen_by = rod_video.cameras(3)
    cameras = {camera.name: camera for camera in seen_by}
    places = AT + np.arange(4)[:, None] * [0.001, 0.0, 0.002]
    contact = {
        name: {frame: camera.project(places[frame : frame + 1])[0][0] for frame in range(4)}
        for name, camera in cameras.items()
    }
    del contact["camera0"][2], contact["camera1"][2], contact["camera2"][1]
    found = coarse_contact(cameras, contact, 6)
    assert found[[0, 1, 3]] == pytest.approx(places[[0, 1, 3]], abs=1e-10)
    assert np.isnan(found[[2, 4, 5]]).all(), "one camera alone, or none, places nothing"
    with pytest.raises(CaptureError, match="shows the contact nowhere in two cameras"):
        coarse_contact(cameras, {"camera0": contact["camera0"]}, 6)


ROD = rod_video.RodMotion(start=((0.1, 0.0, 0.2), (0.0, 0.01, 0.0)))


def rod_tracks(noise: float = 1e-4) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Places at rest, tracks and the contact, of points all over the rod."""
    rest = np.asarray(rod_video.rod().vertices)
    draw = np.random.default_rng(2)
    tracks = np.stack([ROD(rest, frame) for frame in range(rod_video.FRAMES)])
    tracks += noise * draw.standard_normal(tracks.shape)
    tracks[draw.uniform(size=tracks.shape[:2]) < 0.1] = np.nan
    coarse = np.full((rod_video.FRAMES, 3), np.nan)
    for frame in range(0, rod_video.FRAMES, 2):
        rotation, shift = ROD.hand(frame)
        coarse[frame] = rotation @ rod_video.CONTACT + shift + 5e-4 * draw.standard_normal(3)
    return rest, tracks, coarse


def hand() -> tuple[np.ndarray, np.ndarray]:
    poses = [ROD.hand(frame) for frame in range(rod_video.FRAMES)]
    return np.stack([r for r, _ in poses]), np.stack([p for _, p in poses])


def test_the_contact_is_carried_back_to_rest() -> None:
    rest, tracks, coarse = rod_tracks()
    assert contact_at_rest(rest, tracks, coarse) == pytest.approx(rod_video.CONTACT, abs=1.5e-3)
    with pytest.raises(ValueError, match=f"no frame has the contact and {CORE} tracks"):
        contact_at_rest(rest, tracks, np.full_like(coarse, np.nan))


def test_what_is_held_and_its_motion_are_found() -> None:
    rest, tracks, coarse = rod_tracks()
    grip = find_grip(rest, tracks, coarse)
    rotation, shift = hand()
    held = rest[grip.held]
    error = carried(held, grip.motion.turn, grip.motion.position) - carried(held, rotation, shift)
    assert np.sqrt((error**2).mean()) < 1e-4
    assert grip.residual == pytest.approx(1e-4, rel=0.3), "the noise of the tracks"
    # all that is rigid, and little of what bends: at 0.045 m it is off by half a tenth of a millimetre
    rigid = rest[:, 0] < rod_video.HELD - 0.004
    assert np.isin(np.flatnonzero(rigid), grip.held).mean() > 0.9
    assert 0.5 * rod_video.HELD < held[:, 0].max() < 2.0 * rod_video.HELD
    assert (grip.box[0] < held.min(axis=0)).all() and (grip.box[1] > held.max(axis=0)).all()
    assert (grip.box[1] - held.max(axis=0)).max() < 5e-3


def test_tracks_that_are_wrong_do_not_pull() -> None:
    rest, tracks, coarse = rod_tracks()
    rotation, shift = hand()
    near = np.argsort(np.linalg.norm(rest - rod_video.CONTACT, axis=1))[2:5]
    tracks[4:, near] += [0.0, 0.006, 0.0]
    grip = find_grip(rest, tracks, coarse, radius=0.012)
    held = rest[grip.held]
    error = carried(held, grip.motion.turn, grip.motion.position) - carried(held, rotation, shift)
    assert np.sqrt((error**2).mean()) < 2e-4


def test_a_radius_says_what_is_held() -> None:
    rest, tracks, coarse = rod_tracks()
    grip = find_grip(rest, tracks, coarse, radius=0.012)
    distance = np.linalg.norm(rest[grip.held] - grip.motion.at, axis=1)
    assert distance.max() <= 0.012
    others = np.setdiff1d(np.arange(len(rest)), grip.held)
    assert np.linalg.norm(rest[others] - grip.motion.at, axis=1).min() > 0.012
    with pytest.raises(ValueError, match="tracks within 0.001 m of the contact; expected at least 6"):
        find_grip(rest, tracks, coarse, radius=1e-3)


def test_too_few_tracks_are_refused() -> None:
    rest, tracks, coarse = rod_tracks()
    with pytest.raises(ValueError, match=f"{CORE - 1} tracks; expected at least {CORE}"):
        find_grip(rest[: CORE - 1], tracks[:, : CORE - 1], coarse)
