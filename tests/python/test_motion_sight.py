"""What one picture says of points: which it shows, how far they are off, and how sure that is."""

from dataclasses import replace

import numpy as np
import pytest
import torch

import rod_video
from mphygs.capture.views import Photograph
from mphygs.motion.sight import Sight, SightRule, seen_points, sight_of
from mphygs.render.picture import Optics
from mphygs.render.splatting import splat
from mphygs.scene.gaussians import Gaussians

RULE = SightRule()
CAMERA = rod_video.cameras(3, 96)[1]
PIXEL = 0.16 / 96


@pytest.fixture(scope="module")
def gaussians() -> Gaussians:
    return rod_video.gaussians(1200)


def photograph_of(gaussians: Gaussians) -> Photograph:
    """A picture that the Gaussians explain wholly."""
    with torch.no_grad():
        picture = splat(gaussians, CAMERA, optics=Optics(blur=RULE.softness))
    opacity = picture.opacity.numpy()
    colour = picture.colour.numpy() / np.maximum(opacity, 1e-3)[..., None]
    return Photograph(CAMERA, colour.astype(np.float32), opacity)


def shifted(gaussians: Gaussians, pixels: np.ndarray) -> Gaussians:
    """Moved across the line of sight by so many pixels (2,)."""
    step = PIXEL * pixels @ CAMERA.camera_from_world[:2, :3]
    return replace(gaussians, positions=gaussians.positions + torch.as_tensor(step, dtype=torch.float32))


def seen(gaussians: Gaussians, photograph: Photograph, **more: object) -> Sight:
    points = gaussians.positions.numpy().astype(np.float64)
    return sight_of(gaussians, points, photograph, behind=2e-3, noise=0.1, rule=RULE, **more)


def displacement(sight: Sight) -> np.ndarray:
    """(2,) [px], of all points together."""
    trusted = sight.trust > 0.5
    return np.linalg.solve(sight.information[trusted].sum(axis=0), sight.pull[trusted].sum(axis=0))


@pytest.mark.parametrize("shift", [(0.3, 0.0), (0.0, -0.3), (-0.2, 0.25)])
def test_a_shift_is_seen_with_its_sign_and_size(gaussians: Gaussians, shift: tuple[float, float]) -> None:
    photograph = photograph_of(shifted(gaussians, np.array(shift)))
    sight = seen(gaussians, photograph)
    assert displacement(sight) == pytest.approx(np.array(shift), abs=0.06)
    coarse = seen(gaussians, photograph, factor=2)
    assert coarse.camera.width == CAMERA.width // 2
    assert displacement(coarse) == pytest.approx(0.5 * np.array(shift), abs=0.04), "in its own pixels"


def test_what_is_explained_pulls_nowhere(gaussians: Gaussians) -> None:
    sight = seen(gaussians, photograph_of(gaussians))
    assert np.abs(displacement(sight)).max() < 5e-3 and sight.difference < 0.02
    assert np.median(sight.trust[sight.visible]) > 0.9
    assert (sight.trust[~sight.visible] == 0).all() and (sight.information[~sight.visible] == 0).all()
    assert (np.linalg.eigvalsh(sight.information[sight.visible]) > -1e-9).all()


def test_noise_makes_it_less_sure(gaussians: Gaussians) -> None:
    photograph = photograph_of(gaussians)
    points = gaussians.positions.numpy().astype(np.float64)
    sure, less = (
        sight_of(gaussians, points, photograph, behind=2e-3, noise=noise, rule=RULE) for noise in (0.1, 0.2)
    )
    assert sure.information == pytest.approx(4.0 * less.information)


def test_points_at_the_back_are_hidden(gaussians: Gaussians) -> None:
    sight = seen(gaussians, photograph_of(gaussians))
    points = gaussians.positions.numpy()
    way = CAMERA.position - points.mean(axis=0)
    normal = np.zeros_like(points)
    half = np.array([0.5 * rod_video.LENGTH, 0.5 * rod_video.WIDE, 0.5 * rod_video.HIGH])
    side = np.abs((points - [half[0], 0, 0]) / half).argmax(axis=1)
    centred = points - [half[0], 0, 0]
    normal[np.arange(len(points)), side] = np.sign(centred[np.arange(len(points)), side])
    facing = normal @ way / np.linalg.norm(way)
    # but for some at the outline, where less than a third of a pixel is covered
    assert sight.visible[facing > 0.4].mean() > 0.9
    # not at the edges, where the front is near
    back = (facing < -0.4) & (np.sort(np.abs(centred / half), axis=1)[:, 1] < 0.7)
    assert back.sum() > 50 and sight.visible[back].mean() < 0.1


def test_points_off_the_picture_or_behind_the_camera_are_not_seen(gaussians: Gaussians) -> None:
    with torch.no_grad():
        picture = splat(gaussians, CAMERA)
    right, forward = CAMERA.camera_from_world[0, :3], CAMERA.camera_from_world[2, :3]
    middle = np.array([0.5 * rod_video.LENGTH, 0.0, 0.0])
    points = np.stack([middle, middle + 1.0 * right, CAMERA.position - 0.1 * forward])
    found = seen_points(picture, CAMERA, points, behind=0.02, margin=1.0)
    assert found.tolist() == [True, False, False]


def test_what_covers_the_object_is_not_trusted(gaussians: Gaussians) -> None:
    photograph = photograph_of(gaussians)
    colour = photograph.colour.copy()
    half = CAMERA.width // 2
    colour[:, :half] = [0.0, 1.0, 0.0]
    sight = seen(gaussians, replace(photograph, colour=colour))
    pixels = CAMERA.project(gaussians.positions.numpy().astype(np.float64))[0]
    left, right = pixels[:, 0] < half - 6, pixels[:, 0] > half + 12
    assert np.median(sight.trust[sight.visible & left]) < 0.3
    assert np.median(sight.trust[sight.visible & right]) > 0.7


def test_another_brightness_is_no_motion(gaussians: Gaussians) -> None:
    photograph = photograph_of(gaussians)
    darker = replace(photograph, colour=0.85 * photograph.colour)
    assert np.abs(displacement(seen(gaussians, darker))).max() < 0.03


def test_features_are_compared_as_colours_are(gaussians: Gaussians) -> None:
    """Grey Gaussians, which say nothing by colour, told apart by features alone."""
    stripes = torch.as_tensor(
        0.5 + 0.5 * np.sin(500.0 * gaussians.positions.numpy()[:, :1] + [0.0, 1.5]), dtype=torch.float32
    )
    grey = replace(gaussians, harmonics=torch.zeros_like(gaussians.harmonics), features=stripes)
    along = CAMERA.camera_from_world[:2, 0]  # of the rod, in the picture: its outline hardly changes
    shift = 0.3 * along / np.linalg.norm(along)
    moved = shifted(grey, shift)
    photograph = photograph_of(moved)
    with torch.no_grad():
        picture = splat(moved, CAMERA, optics=Optics(blur=RULE.softness))
    features = picture.features.numpy() / np.maximum(photograph.mask, 1e-3)[..., None]
    with_them, without = seen(grey, photograph, features=features), seen(grey, photograph)
    assert displacement(with_them) == pytest.approx(shift, abs=0.06)
    direction = along / np.linalg.norm(along)
    sure = [direction @ s.information.sum(axis=0) @ direction for s in (with_them, without)]
    assert sure[0] > 3.0 * sure[1]
