"""The object at rest brought to frame 0: with points pointed at, some wrong, and without any."""

from dataclasses import replace

import numpy as np
import pytest

import rod_video
from mphygs.capture.annotations import Correspondence
from mphygs.motion.registration import Registration, register
from mphygs.motion.tracking import TrackingRule

MOTION = rod_video.RodMotion(start=((0.1, -0.2, 0.3), (0.01, -0.006, 0.008)))
SIZE = 96
PIXEL = 0.16 / SIZE
RULE = TrackingRule(control_points=40)
GAUSSIANS = rod_video.gaussians(1000)
REST, FIRST = rod_video.cameras(3, 64, name="rest"), rod_video.cameras(4, SIZE)


def registered(correspondences: list[Correspondence]) -> Registration:
    photographs = rod_video.frames_of(MOTION, FIRST)[0]
    return register(
        GAUSSIANS, photographs, correspondences, rest_cameras={c.name: c for c in REST},
        first_cameras={c.name: c for c in FIRST}, rule=RULE,
    )  # fmt: skip


def errors(found: Registration) -> tuple[float, float]:
    """Root mean squares [m] of the rigid motion and of the refined Gaussians from where they are."""
    rest = GAUSSIANS.positions.numpy().astype(np.float64)
    truth = MOTION(rest, 0)
    return tuple(
        float(np.sqrt(((places - truth) ** 2).sum(axis=1).mean()))
        for places in (found.motion.of(rest), found.refined)
    )


def test_points_then_pictures() -> None:
    correspondences = rod_video.correspondences(MOTION, REST, FIRST)
    # one of the ten was confused with another
    wrong = replace(correspondences[2], first=correspondences[6].first)
    found = registered([*correspondences[:2], wrong, *correspondences[3:]])
    assert found.by == "correspondences" and not found.agree[2] and found.agree.sum() >= 7
    assert found.apart[2] > 5e-3 and np.median(found.apart[found.agree]) < 2e-3
    rigid, refined = errors(found)
    assert rigid < 0.3 * PIXEL and refined < 0.3 * PIXEL
    assert found.difference < 0.12


def test_pictures_alone() -> None:
    found = registered(rod_video.correspondences(MOTION, REST, FIRST)[:3])
    assert found.by == "pictures" and found.apart.shape == found.agree.shape == (0,)
    rigid, refined = errors(found)
    assert rigid < 0.3 * PIXEL and refined < 0.3 * PIXEL


def test_points_that_fix_nothing_are_said() -> None:
    one = rod_video.correspondences(MOTION, REST, FIRST)[0]
    with pytest.raises(ValueError, match="4 points do not fix a rotation"):
        registered([one] * 4)
