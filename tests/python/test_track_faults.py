"""Faults that tracks show by themselves: found, told with their numbers, put right."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from capture_example import Example, write_c3d
from mphygs.capture.track_faults import marker_survey_repair
from mphygs.capture.track_faults.noise_level_repair import quantum
from mphygs.capture.track_faults.scatter import own_noise, scatter
from mphygs.capture.track_faults.track_repair import REPAIRS, repaired_tracks
from mphygs.capture.track_faults.tracks import ExaminedTracks
from mphygs.compare.noise import _with_offset
from mphygs.compare.whitening import NoiseModel
from mphygs.model.registry import faults

SIGMA, FRAMES, FPS = 2e-4, 48, 60.0
SEEDS = range(5)


def moving(seed: int, *, sigma: float = SIGMA, frames: int = FRAMES) -> ExaminedTracks:
    """Markers on a bar that bends and twists in three ways, with noise and gaps."""
    random = np.random.default_rng(seed)
    at = random.uniform([0.0, -0.01, -0.01], [0.1, 0.01, 0.01], (30, 3)) + [0.05, 0.02, 0.3]
    along = (at[:, 0] - 0.05) / 0.1
    t = np.arange(frames + 4)[:, None] / FPS
    phase = random.uniform(0, 6, 3)
    swing = [np.sin(2 * np.pi * f * t + p) for f, p in zip((3.1, 4.7, 6.2), phase, strict=True)]
    position = np.tile(at, (frames + 4, 1, 1))
    position[..., 2] += 0.02 * along**2 * swing[0]
    position[..., 1] += 0.01 * along**2 * swing[1] + 0.2 * along * (at[:, 2] - 0.3) * swing[2]
    position += sigma * random.standard_normal(position.shape)
    position[random.random(position.shape[:2]) < 0.01] = np.nan
    return ExaminedTracks(position, at, SIGMA)


def seen(position: np.ndarray, tracks: ExaminedTracks) -> ExaminedTracks:
    return repaired_tracks(ExaminedTracks(position[:FRAMES], tracks.at, tracks.sigma, tracks.release))


def only(found: ExaminedTracks, fault: str) -> dict[str, float]:
    assert [finding.fault for finding in found.findings] == [fault]
    return found.findings[0].numbers


def test_every_fault_is_one_of_the_registry() -> None:
    assert set(REPAIRS) <= {fault.name for fault in faults()}


@pytest.mark.parametrize("seed", range(10))
def test_clean_tracks_show_nothing_and_stay_as_they_are(seed: int) -> None:
    tracks = moving(seed)
    found = seen(tracks.position, tracks)
    assert found.findings == () and found.sigma == SIGMA and found.scatter is None
    assert np.array_equal(found.position, tracks.position[:FRAMES], equal_nan=True)


@pytest.mark.parametrize("seed", SEEDS)
def test_noise_is_told_beside_a_motion(seed: int) -> None:
    shown = scatter(moving(seed).position)
    assert np.median(shown.sigma) == pytest.approx(SIGMA, rel=0.08)


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("count", [1, 2])
def test_lost_frames_are_put_in(seed: int, count: int) -> None:
    tracks = moving(seed)
    frame = int(np.random.default_rng(100 + seed).integers(6, FRAMES - 10))
    lost = np.delete(tracks.position, np.arange(frame, frame + count), axis=0)
    found = seen(lost, tracks)
    assert only(found, "frame_drops") == {"lost": count, "repeated": 0.0}
    assert f"{count} before frame {frame}" in found.findings[0].text
    there = np.delete(np.arange(FRAMES), np.arange(frame, frame + count))
    assert np.array_equal(found.position[there], tracks.position[there], equal_nan=True)
    assert np.isnan(found.position[frame : frame + count]).all()


@pytest.mark.parametrize("seed", SEEDS)
def test_a_repeated_frame_is_taken_out(seed: int) -> None:
    tracks = moving(seed)
    frame = int(np.random.default_rng(200 + seed).integers(6, FRAMES - 10))
    repeated = np.insert(tracks.position, frame, tracks.position[frame - 1], axis=0)
    found = seen(repeated, tracks)
    assert only(found, "frame_drops")["repeated"] == 1.0
    assert "put at their times" in found.findings[0].text
    assert np.array_equal(found.position[: FRAMES - 1], tracks.position[: FRAMES - 1], equal_nan=True)
    frozen = tracks.position.copy()
    frozen[frame] = frozen[frame - 1]
    found = seen(frozen, tracks)
    assert only(found, "frame_drops")["repeated"] == 1.0 and np.isnan(found.position[frame]).all()
    later = slice(frame + 1, FRAMES)
    assert np.array_equal(found.position[later], tracks.position[later], equal_nan=True)


def test_a_single_marker_that_slips_is_no_clock() -> None:
    tracks = moving(3)
    slipped = tracks.position.copy()
    slipped[20:26, 4] += [0.0, 4e-3, 2e-3]
    assert "frame_drops" not in [f.fault for f in seen(slipped, tracks).findings]


def test_an_object_at_rest_repeats_no_frame() -> None:
    tracks = moving(1)
    still = tracks.position.copy()
    still[:12] = still[12]
    assert seen(still, tracks).findings == ()


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("length", [6, FRAMES])
def test_swapped_labels_are_put_right(seed: int, length: int) -> None:
    tracks = moving(seed)
    random = np.random.default_rng(300 + seed)
    one, two = sorted(random.choice(30, 2, replace=False))
    frame = int(random.integers(5, 30))
    swapped = tracks.position.copy()
    span = slice(frame, frame + length)
    swapped[span, [one, two]] = swapped[span, [two, one]]
    found = seen(swapped, tracks)
    assert only(found, "label_swaps")["markers"] == 2
    assert f"{one}" in found.findings[0].text and f"{two}" in found.findings[0].text
    assert np.array_equal(found.position, tracks.position[:FRAMES], equal_nan=True)


def test_labels_that_are_wrong_from_the_first_frame_on_are_told_by_their_places() -> None:
    tracks = moving(2)
    order = np.arange(30)
    order[[3, 7, 20]] = [7, 20, 3]
    found = seen(tracks.position[:, order], tracks)
    assert only(found, "label_swaps")["markers"] == 3
    assert np.array_equal(found.position, tracks.position[:FRAMES], equal_nan=True)


@pytest.mark.parametrize("seed", SEEDS)
def test_rounded_positions_count_with_their_rounding(seed: int) -> None:
    tracks = moving(seed)
    found = seen(np.round(tracks.position, 3), tracks)
    numbers = only(found, "noise_level")
    assert numbers["step"] == pytest.approx(1e-3, rel=1e-6)
    assert found.sigma == pytest.approx(np.hypot(SIGMA, 1e-3 / np.sqrt(12.0)), rel=0.1)


def test_numbers_of_a_file_are_no_rounding() -> None:
    position = moving(0).position
    assert quantum(position.astype(np.float32).astype(float), SIGMA) == 0.0
    assert quantum(np.round(position, 6), SIGMA) == 0.0
    assert quantum((1e3 * np.round(position, 4)).astype(np.float32).astype(float) * 1e-3, SIGMA) == (
        pytest.approx(1e-4, rel=1e-4)
    )


@pytest.mark.parametrize("seed", SEEDS)
def test_markers_that_scatter_more_have_a_sigma_of_their_own(seed: int) -> None:
    tracks = moving(seed)
    random = np.random.default_rng(400 + seed)
    noisy = random.choice(30, 5, replace=False)
    position = tracks.position.copy()
    position[:, noisy] += 1e-3 * random.standard_normal((len(position), 5, 3))
    found = seen(position, tracks)
    only(found, "noise_level")
    quiet = np.setdiff1d(np.arange(30), noisy)
    assert found.scatter[noisy] == pytest.approx(np.hypot(SIGMA, 1e-3), rel=0.35)
    assert np.median(found.scatter[quiet]) == pytest.approx(SIGMA, rel=0.15)


@pytest.mark.parametrize("seed", SEEDS)
def test_noise_above_the_stated_one_is_used(seed: int) -> None:
    tracks = moving(seed, sigma=3.0 * SIGMA)
    found = seen(tracks.position, tracks)
    assert only(found, "noise_level")["stated"] == SIGMA
    assert found.sigma == pytest.approx(3.0 * SIGMA, rel=0.1)


def test_tracks_that_are_lost_and_single_bad_values_are_no_noise() -> None:
    tracks = moving(4)
    random = np.random.default_rng(5)
    walk = tracks.position.copy()
    walk[:, [2, 9]] += np.cumsum(1.3e-3 * random.standard_normal((len(walk), 2, 3)), axis=0)
    assert seen(walk, tracks).scatter is None
    bad = tracks.position.copy()
    bad[random.random(bad.shape[:2]) < 0.02] += 0.01
    assert seen(bad, tracks).scatter is None


def resting(seed: int) -> ExaminedTracks:
    """The bar, at rest for two frames before it moves."""
    tracks = moving(seed)
    position = np.concatenate([np.tile(tracks.at, (2, 1, 1)), tracks.position[2:]])
    position[:2] += SIGMA * np.random.default_rng(600 + seed).standard_normal((2, 30, 3))
    return ExaminedTracks(position[:FRAMES], tracks.at, SIGMA, release=2)


@pytest.mark.parametrize("seed", SEEDS)
def test_places_surveyed_wrongly_are_found_where_they_rest(seed: int) -> None:
    clean = resting(seed)
    assert marker_survey_repair.repair_marker_survey(clean) is clean
    error = 6e-4 * np.random.default_rng(500 + seed).standard_normal(clean.at.shape)
    found = marker_survey_repair.repair_marker_survey(replace(clean, at=clean.at + error))
    assert only(found, "marker_survey")["sigma"] == pytest.approx(6e-4, rel=0.3)
    left = np.sqrt(np.mean((found.at - clean.at) ** 2))
    assert left == pytest.approx(SIGMA / np.sqrt(2.0), rel=0.35)
    assert found.lasting == pytest.approx(left, rel=0.35)


def test_what_is_smooth_at_rest_or_one_marker_s_is_no_survey() -> None:
    clean = resting(1)
    bent = clean.position.copy()
    bent[..., 2] -= 0.01 * ((clean.at[:, 0] - 0.05) / 0.1) ** 2
    scaled = 1.03 * clean.position
    one = clean.position.copy()
    one[:, 4] += 4e-3
    for position in (bent, scaled, one):
        assert marker_survey_repair.repair_marker_survey(replace(clean, position=position)).findings == ()
    error = 6e-4 * np.random.default_rng(7).standard_normal(clean.at.shape)
    unrested = replace(clean, at=clean.at + error, begins="measured")
    assert marker_survey_repair.repair_marker_survey(unrested) is unrested


def test_places_that_are_not_known_are_noise_that_stays() -> None:
    noise = _with_offset(NoiseModel.white(2e-4, "stated"), 1.5e-4)
    assert noise.sigma == pytest.approx(2.5e-4)
    random = np.random.default_rng(8)
    drawn = 2e-4 * random.standard_normal((40, 200, 3)) + 1.5e-4 * random.standard_normal((200, 3))
    whitened = noise.whiten(drawn, np.ones((40, 200), bool))
    assert np.mean(whitened**2) == pytest.approx(1.0, abs=0.05)
    # A shift of one marker is worth its 40 frames no more, but what its place is known to.
    shift = noise.whiten(np.ones((40, 1, 3)), np.ones((40, 1), bool))
    assert (shift**2).sum() / 3.0 == pytest.approx(1.0 / (1.5e-4**2 + 2e-4**2 / 40), rel=0.15)


def test_a_c3d_is_put_right_in_the_object_s_frame(tmp_path: Path) -> None:
    example = Example(tmp_path)
    track = example.tracks + [2.0, 1.0, 0.5]
    swapped = track.copy()
    swapped[8:, [0, 1]] = swapped[8:, [1, 0]]
    results = []
    for position in (track, swapped):
        write_c3d(tmp_path / "markers.c3d", position, labels=["a", "b", "c", "d"])
        example.sequence["markers"]["file"] = "markers.c3d"
        results.append(example.load().sequences[0].markers)
    clean, found = results
    assert clean.findings == () and [f.fault for f in found.findings] == ["label_swaps"]
    np.testing.assert_allclose(found.position, clean.position, atol=1e-6)


@pytest.mark.parametrize(("count", "ways"), [(12, 4), (12, 8), (36, 8)])
def test_what_a_marker_has_of_its_own_is_told_from_few_others(count: int, ways: int) -> None:
    """Of motions in several ways, as large as a thousand times the noise: that is in the others as well."""
    told = []
    for seed in range(6):
        draw = np.random.default_rng((77, count, ways, seed))
        time = np.linspace(0.0, 1.0, 60)
        phase, turns = draw.uniform(0.0, 6.0, (ways, 1)), np.arange(1.0, ways + 1.0)[:, None]
        course = np.sin(2.0 * np.pi * turns * time + phase)
        motion = np.einsum("kt,kmc->tmc", course, draw.normal(0.0, 0.1, (ways, count, 3)))
        told.append(own_noise(motion + 1e-4 * draw.standard_normal(motion.shape)))
    assert np.median(told) == pytest.approx(1e-4, rel=0.06)


@pytest.mark.parametrize("seed", SEEDS)
def test_noise_that_lasts_over_the_resting_frames_is_no_survey(seed: int) -> None:
    """Half of its variance all but stays over six frames: the mean of these is off by it, and no place is."""
    clean, random = replace(resting(seed), release=6), np.random.default_rng(700 + seed)
    slow = np.empty_like(clean.position)
    slow[0] = random.standard_normal(slow[0].shape)
    for k in range(1, len(slow)):
        slow[k] = 0.9 * slow[k - 1] + np.sqrt(1.0 - 0.81) * random.standard_normal(slow[0].shape)
    fresh = random.standard_normal(slow.shape)
    true = moving(seed, sigma=0.0).position[6:FRAMES]
    still = np.concatenate([np.tile(clean.at, (6, 1, 1)), true])
    position = still + SIGMA * np.sqrt(0.5) * (slow + fresh)
    assert marker_survey_repair.repair_marker_survey(replace(clean, position=position)).findings == ()
    error = 6e-4 * random.standard_normal(clean.at.shape)
    found = marker_survey_repair.repair_marker_survey(replace(clean, position=position, at=clean.at + error))
    assert only(found, "marker_survey")["sigma"] == pytest.approx(6e-4, rel=0.35)


def test_tracks_of_nothing_are_passed_on_as_they_are() -> None:
    tracks = moving(0)
    zeros = seen(np.zeros_like(tracks.position), tracks)
    assert only(zeros, "zero_gaps")["count"] == FRAMES * 30 and np.isnan(zeros.position).all()
