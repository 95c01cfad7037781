"""Following a textured rod whose motion is known: errors, stated sigma, lost tracks, broken-off runs."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

import rod_video
from mphygs.capture.rotation import matrix_from_quaternion
from mphygs.capture.views import Photograph
from mphygs.motion.alignment import Aligner, AlignmentRule
from mphygs.motion.control_graph import Pose
from mphygs.motion.stage_files import Tracks
from mphygs.motion.track_choice import chosen_gaussians, tracks_of
from mphygs.motion.track_noise import variance_of_tracks
from mphygs.motion.tracking import Followed, TrackingRule, aligner_of, follow

MOTION = rod_video.RodMotion()
SIZE = 120
PIXEL = 0.16 / SIZE  # [m], of a picture at the rod
RULE = TrackingRule(control_points=60)
TRACKS = 150


@dataclass(frozen=True, eq=False)
class Film:
    """The rod's pictures and what was made of them."""

    frames: list[list[Photograph]]
    aligner: Aligner
    followed: Followed
    tracks: Tracks

    def truth(self) -> np.ndarray:
        """(T, M, 3) [m], where the tracked Gaussians are."""
        return np.stack([MOTION(self.tracks.rest, frame) for frame in range(rod_video.FRAMES)])


@pytest.fixture(scope="module")
def film() -> Film:
    frames = rod_video.frames_of(MOTION, rod_video.cameras(4, SIZE))
    aligner = aligner_of(rod_video.gaussians(1200), RULE)
    aligner = aligner.matched(frames[0], aligner.graph.rest)
    followed = follow(aligner, frames.__getitem__, rod_video.FRAMES, aligner.graph.rest, rule=RULE)
    chosen = chosen_gaussians(aligner, followed, TRACKS)
    variance = variance_of_tracks(aligner, frames.__getitem__, followed, chosen, frames=[1, 4, 7])
    return Film(frames, aligner, followed, tracks_of(aligner, followed, chosen, variance))


def test_tracks_are_near_the_truth(film: Film) -> None:
    moved = np.linalg.norm(film.truth()[-1] - film.tracks.rest, axis=1)
    assert np.median(moved) > 10 * PIXEL / 2, "the motion is large beside the error that is allowed"
    error = film.tracks.position - film.truth()
    assert np.isfinite(film.tracks.position).mean() > 0.95
    by_frame = np.sqrt(np.nanmean(error**2, axis=(1, 2)))
    assert by_frame.max() < 0.4 * PIXEL
    # the tip, which moves most, and the tracks on it stay behind a little
    assert np.nanpercentile(np.linalg.norm(error, axis=2), 95) < PIXEL


def test_the_stated_sigma_is_honest(film: Film) -> None:
    ratio = (film.tracks.position - film.truth()) / film.tracks.sigma[None, :, None]
    assert 0.5 < np.sqrt(np.nanmean(ratio**2)) < 1.6
    by_frame = np.sqrt(np.nanmean(ratio**2, axis=(1, 2)))
    assert by_frame.max() < 2.0, "in no frame far more than stated"


def test_tracks_turn_with_the_rod(film: Film) -> None:
    held = film.tracks.rest[:, 0] < 0.8 * rod_video.HELD
    rotation, _ = MOTION.hand(rod_video.FRAMES - 1)
    turned = film.tracks.quaternion[-1, held]
    found = matrix_from_quaternion(turned[np.isfinite(turned).all(axis=1)])
    assert np.median(np.abs(found - rotation).max(axis=(1, 2))) < 0.06
    assert np.abs(rotation - np.eye(3)).max() > 0.15


def test_tracks_are_those_asked_for(film: Film) -> None:
    tracks = film.tracks
    assert len(tracks.gaussian) == TRACKS and (np.diff(tracks.gaussian) > 0).all()
    assert tracks.rest == pytest.approx(film.aligner.gaussians.positions.numpy()[tracks.gaussian], abs=1e-9)
    assert (np.isnan(tracks.position).any(axis=2) == np.isnan(tracks.quaternion).any(axis=2)).all()
    assert tracks.position.shape == (rod_video.FRAMES, TRACKS, 3)


def test_a_run_broken_off_goes_on_with_the_same_numbers(film: Film) -> None:
    half = Followed(**{name: each[:5] for name, each in vars(film.followed).items()})
    seen: list[int] = []

    def read(frame: int) -> list[Photograph]:
        seen.append(frame)
        return film.frames[frame]

    again = follow(
        film.aligner, read, rod_video.FRAMES, film.aligner.graph.rest, rule=RULE, done=half
    )
    assert seen == [5, 6, 7], "what is done is not done again"
    for name, each in vars(film.followed).items():
        assert np.array_equal(getattr(again, name), each), name


def test_what_is_hidden_in_all_pictures_is_not_a_number(film: Film) -> None:
    """In one frame the free end is covered by something of another colour."""
    frame = 4
    end = MOTION(np.array([[0.085, 0.0, 0.0]]), frame)
    covered = []
    for p in film.frames[frame]:
        pixel = p.camera.project(end)[0][0]
        v, u = np.mgrid[: p.mask.shape[0], : p.mask.shape[1]] + 0.5
        card = np.hypot(u - pixel[0], v - pixel[1]) < 0.014 / PIXEL
        colour = np.where(card[..., None], np.float32([0.0, 1.0, 0.0]), p.colour)
        covered.append(replace(p, colour=colour))
    frames = [*film.frames[:frame], covered, *film.frames[frame + 1 :]]
    followed = follow(film.aligner, frames.__getitem__, 6, film.aligner.graph.rest, rule=RULE)
    tracks = tracks_of(film.aligner, followed, film.tracks.gaussian, np.full((1, TRACKS), 1e-8))
    lost = np.isnan(tracks.position).any(axis=2)
    under = np.linalg.norm(tracks.rest - [0.085, 0.0, 0.0], axis=1) < 0.009
    clear = tracks.rest[:, 0] < 0.05
    assert under.sum() >= 5 and lost[frame, under].mean() > 0.8
    assert lost[frame, clear].mean() < 0.1 and lost[frame - 1, under].mean() < 0.1
    # and the rest of the rod goes on being followed, the end by its neighbours
    error = np.linalg.norm(tracks.position - film.truth()[:6], axis=2)
    assert np.nanmean(error[frame + 1, under]) < PIXEL


def test_a_jerk_is_caught(film: Film) -> None:
    """The rod jumps by twice its thickness between two frames; every frame before it stood still."""
    aligner = film.aligner
    still = film.frames[0]
    mesh = rod_video.rod()
    jump = np.array([0.0, 0.012, 0.012])
    places = np.asarray(mesh.vertices) + jump
    jumped = [rod_video.photograph(p.camera, mesh, places) for p in still]
    followed = follow(
        aligner, [still, still, still, jumped].__getitem__, 4, aligner.graph.rest, rule=RULE
    )
    found = aligner.graph.carried(followed.pose(3)) - aligner.graph.points
    assert np.median(np.linalg.norm(found - jump, axis=1)) < 0.5 * PIXEL


def test_velocity_leads() -> None:
    """A rigid turn goes on wholly; what one control point does alone goes on by half."""
    aligner = aligner_of(rod_video.gaussians(300), RULE)
    graph = aligner.graph
    rotation, shift = MOTION.hand(3)
    before = graph.rest
    after = before.turned(rotation, shift)
    followed = Followed(
        np.stack([before.position, after.position]), np.stack([before.rotation, after.rotation]),
        np.zeros((2, 1)), np.zeros(2),
    )  # fmt: skip
    expected = followed.expected(2)
    twice = after.turned(rotation, shift)
    assert expected.position == pytest.approx(twice.position, abs=1e-12)
    assert expected.rotation == pytest.approx(twice.rotation, abs=1e-12)
    assert Followed(*(each[:1] for each in vars(followed).values())).expected(1).position == pytest.approx(
        before.position
    )
    position = before.position.copy()
    position[3] += [0.0, 0.0, 1e-4]
    rotations = np.stack([before.rotation] * 2)
    alone = replace(followed, position=np.stack([before.position, position]), rotation=rotations)
    led = alone.expected(2).position - before.position
    # the share of one in the motion of the whole is small
    assert led[3, 2] == pytest.approx(1.5e-4, rel=0.15)
    assert np.abs(np.delete(led, 3, axis=0)).max() < 2e-5


def test_rules_that_mean_nothing_are_refused() -> None:
    with pytest.raises(ValueError, match="control_points: 4; expected at least 5"):
        TrackingRule(control_points=4)
    with pytest.raises(ValueError, match="levels"):
        AlignmentRule(levels=((0, 3),))


def test_one_camera_cannot_be_left_out(film: Film) -> None:
    chosen = film.tracks.gaussian
    with pytest.raises(ValueError, match="1 camera; expected at least two"):
        variance_of_tracks(film.aligner, lambda k: film.frames[k][:1], film.followed, chosen, frames=[1])


def test_nothing_seen_is_said(film: Film) -> None:
    blind = replace(film.followed, cameras=np.zeros_like(film.followed.cameras))
    with pytest.raises(ValueError, match="no camera shows"):
        chosen_gaussians(film.aligner, blind, TRACKS)


def test_poses_are_drawn_where_they_are(film: Film) -> None:
    graph = film.aligner.graph
    pose = Pose(graph.rest.position + [0.0, 0.0, 0.01], graph.rest.rotation)
    moved = film.aligner.drawn(pose).positions - film.aligner.gaussians.positions
    assert moved.numpy() == pytest.approx(np.tile([0.0, 0.0, 0.01], (len(moved), 1)), abs=1e-6)
