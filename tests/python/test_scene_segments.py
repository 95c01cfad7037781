"""Affinity, segments and their meshes on objects whose parts are known."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import sparse
from scipy.spatial import cKDTree
from sklearn.metrics import adjusted_rand_score

from mphygs.capture.errors import CaptureError
from mphygs.capture.features import Principal, Reduction
from mphygs.scene.affinity import affinity_features, neighbour_groups
from mphygs.scene.lattice import Lattice
from mphygs.scene.object_files import (
    GaussianFeatures,
    read_features,
    read_particles,
    read_parts,
    write_features,
    write_particles,
    write_parts,
)
from mphygs.scene.part_meshes import segment_meshes
from mphygs.scene.quadrature import fill
from mphygs.scene.segments import FeatureBlock, SegmentSettings, _span_of_one_mode, find_segments
from mphygs.scene.soft_boundary import Particles


def test_members_of_one_group_get_one_feature() -> None:
    draw = np.random.default_rng(0)
    places = np.concatenate([draw.uniform(0, 1, (60, 3)), draw.uniform(0, 1, (60, 3)) + [1.0, 0, 0]])
    true = np.repeat([0, 1], 60)
    rows, columns, count = [], [], 0
    # every group holds some of one half, as the superpixels of many views do; one in twenty is wrong
    for half in np.tile([0, 1], 60):
        members = draw.choice(np.flatnonzero(true == half), 15, replace=False)
        members[0] = draw.integers(120) if draw.uniform() < 0.05 else members[0]
        rows += members.tolist()
        columns += [count] * 15
        count += 1
    membership = sparse.csr_matrix((np.ones(len(rows)), (rows, columns)), shape=(120, count))
    near = neighbour_groups(cKDTree(places).query(places, k=6)[1])
    found = affinity_features(membership, near, count=4)
    assert found.shape == (120, 4) and found.dtype == np.float32
    first = found[:, 0]
    assert (np.sign(first - first.mean()) == np.sign(first[0] - first.mean()))[true == 0].all()
    assert abs(first[true == 0].mean() - first[true == 1].mean()) > 6 * first[true == 0].std()
    # the same again, whatever the solver began with
    assert found == pytest.approx(affinity_features(membership, near, count=4), abs=1e-5)
    with pytest.raises(ValueError, match="membership: has shape"):
        affinity_features(membership[:5], near[:5], count=4)


def two_petals_and_a_stem() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Places, true part (stem 0, petals 1) and petal or stem (0, 1, 2)."""
    draw = np.random.default_rng(1)
    stem = draw.uniform([-0.1, -0.1, 0], [0.1, 0.1, 2], (600, 3))
    left = draw.uniform([-1.5, -0.2, 2], [-0.1, 0.2, 2.1], (500, 3))
    right = draw.uniform([0.1, -0.2, 2], [1.5, 0.2, 2.1], (500, 3))
    each = np.repeat([0, 1, 2], [600, 500, 500])
    return np.concatenate([stem, left, right]), np.minimum(each, 1), each


def test_segments_are_parts_of_one_look_or_each_petal_for_itself() -> None:
    places, true, each = two_petals_and_a_stem()
    draw = np.random.default_rng(2)
    look = np.eye(2)[true] + 0.15 * draw.standard_normal((len(true), 2))
    groups = np.eye(3)[each] + 0.15 * draw.standard_normal((len(true), 3))
    blocks = [FeatureBlock(look, 1.0), FeatureBlock(groups, 0.5, tells=False)]
    whole = find_segments(places, blocks, SegmentSettings(samples=1200, least_cluster=0.05))
    assert whole.dtype == np.int32 and adjusted_rand_score(true, whole) > 0.97
    assert np.array_equal(np.bincount(whole), np.sort(np.bincount(whole))[::-1])
    apart = find_segments(places, blocks, SegmentSettings(samples=1200, least_cluster=0.05, alike=0.0))
    pure = [np.bincount(each[apart == k]).max() / (apart == k).sum() for k in range(apart.max() + 1)]
    assert apart.max() >= 2 and min(pure) > 0.95, "petals are not joined"
    few = find_segments(places, blocks, SegmentSettings(samples=1200, alike=0.0, most=2))
    assert few.max() == 1
    with pytest.raises(ValueError, match="at least 50"):
        find_segments(places[:20], blocks)
    with pytest.raises(ValueError, match="none tells segments apart"):
        find_segments(places, [FeatureBlock(look, 0.0)])


def bar() -> tuple[Lattice, np.ndarray, np.ndarray, np.ndarray]:
    """A bar of 40 x 10 x 10 mm, its distances, points in it and their halves."""
    half = np.array([0.02, 0.005, 0.005])
    lattice = Lattice.about(np.stack([-half, half]), spacing=1e-3, margin=3e-3)
    away = np.abs(lattice.points()) - half
    distance = np.minimum(away.max(1), 0) + np.linalg.norm(np.maximum(away, 0), axis=1)
    inner = lattice.points()[distance < -2e-4]
    return lattice, distance.reshape(lattice.shape), inner, (inner[:, 0] > 0.008).astype(int)


def test_meshes_of_segments_are_closed_and_fill_the_object(tmp_path: Path) -> None:
    lattice, distance, points, label = bar()
    parts = segment_meshes(lattice, distance, points, label, ["segment-00", "segment-01"])
    volumes = np.array([part.volume for part in parts])
    assert volumes.sum() == pytest.approx(4e-6, rel=0.05)
    assert volumes[0] / volumes.sum() == pytest.approx(0.7, abs=0.02)
    # they meet where the labels do, half way between two layers of points
    border = 0.5 * (points[label == 0][:, 0].max() + points[label == 1][:, 0].min())
    assert parts[0].bounds[1, 0] == pytest.approx(border, abs=3e-4)
    assert parts[1].bounds[0, 0] == pytest.approx(border, abs=3e-4)
    filled = fill(parts, spacing=4e-3)
    assert filled.free_volume == pytest.approx(volumes, rel=0.02)
    write_parts(tmp_path / "parts", parts)
    again = read_parts(tmp_path / "parts")
    assert [part.name for part in again] == ["segment-00", "segment-01"]
    assert [part.volume for part in again] == pytest.approx(volumes)
    write_parts(tmp_path / "parts", parts[:1])
    assert len(read_parts(tmp_path / "parts")) == 1


def test_files_of_the_object_come_back_or_say_what_is_wrong(tmp_path: Path) -> None:
    draw = np.random.default_rng(0)
    features = GaussianFeatures(draw.standard_normal((5, 3)), draw.standard_normal((5, 2)), "colour")
    path = tmp_path / "features.npz"
    write_features(path, features)
    again = read_features(path, 5)
    assert again.appearance == pytest.approx(features.appearance, abs=1e-6) and again.source == "colour"
    assert again.reduction is None and again.made_by == ""
    with pytest.raises(CaptureError, match=r"appearance: is float32 of shape \(5, 3\); expected numbers"):
        read_features(path, 6)
    first, second = (
        Principal(draw.standard_normal(4 + k), draw.standard_normal((4 + k, 1 + k)), 2.0 + k) for k in (0, 1)
    )
    known = replace(features, made_by="xfeat+colour", reduction=Reduction(((first, 0.5), (second, 1.0))))
    write_features(path, known)
    again = read_features(path, 5)
    assert again.made_by == "xfeat+colour"
    for (one, weight), (other, same) in zip(known.reduction.parts, again.reduction.parts, strict=True):
        assert weight == same and one.scale == other.scale
        assert np.array_equal(one.mean, other.mean) and np.array_equal(one.axes, other.axes)
    write_features(path, replace(known, reduction=Reduction(((first, 0.5),))))
    with pytest.raises(CaptureError, match="axes: give 1 channels; expected 3"):
        read_features(path, 5)
    particles = Particles(
        draw.uniform(size=(4, 3)), np.zeros(4), 2e-3, np.array([0, 1, 1, 0]), np.zeros((4, 2))
    )
    path = tmp_path / "particles.npz"
    write_particles(path, particles)
    back = read_particles(path)
    assert back.position == pytest.approx(particles.position) and back.segment_count == 2
    assert back.pixel is None and back.resolution == 2e-3
    write_particles(path, replace(particles, pixel=3e-4))
    assert read_particles(path).resolution == 3e-4
    with pytest.raises(ValueError, match="pixel: -1"):
        replace(particles, pixel=-1.0)
    stored = dict(np.load(path))

    def refused(match: str, **changed: np.ndarray) -> None:
        np.savez(path, **(stored | changed))
        with pytest.raises(CaptureError, match=match) as caught:
            read_particles(path)
        assert str(path) in str(caught.value) and "\n" not in str(caught.value)

    refused("no gaps", label=np.array([0, 2, 2, 0]))
    refused("whole numbers", label=np.array([0, 0.5, 1, 0]))
    refused("not finite", signed_distance=np.full(4, np.nan))
    refused("above zero", spacing=np.array(-1.0))
    refused("zero or more", pixel=np.array(-1.0))
    refused("label", label=np.zeros(3))
    path.write_bytes(b"nothing")
    with pytest.raises(CaptureError, match="is not an .npz file, or is truncated"):
        read_particles(path)
    with pytest.raises(CaptureError, match="holds no .ply"):
        read_parts(tmp_path)


def test_what_one_mode_spans_is_where_a_mixture_of_two_normals_gets_a_second() -> None:
    for first, second in ((1.0, 1.0), (1.0, 2.0), (0.8, 1.0), (0.3, 1.0), (0.02, 1.0)):
        span = float(_span_of_one_mode(np.array(first**2), np.array(second**2)))
        for times, one_mode in ((0.99, True), (1.01, False)):
            # The densities' slopes cancel at x for shares in one ratio: each has but one x where that rises.
            away = times * span
            x = np.linspace(0.0, away, 20002)[1:-1]
            log = np.log(x / first**2) - 0.5 * (x / first) ** 2
            log -= np.log((away - x) / second**2) - 0.5 * ((away - x) / second) ** 2
            assert (np.diff(log) > 0).all() == one_mode, (first, second, times)
    # 1.5 sqrt(3) of the narrower one where the other is far wider, and nothing of what has no spread
    found = _span_of_one_mode(np.array([1e-12, 0.0]), np.array([1.0, 0.0]))
    assert found == pytest.approx([1.5e-6 * 3.0**0.5, 0.0], rel=1e-6)


def test_segments_are_told_apart_by_their_own_spread_and_not_by_what_else_is_there() -> None:
    """A stem, a head and two petals: stem and head look nearly alike beside the petals, but each evenly so;
    the petals differ by more than those two, but more still within each."""
    draw = np.random.default_rng(3)
    boxes = (
        ([-0.1, -0.1, 0.0], [0.1, 0.1, 2.0]),
        ([-0.3, -0.3, 2.0], [0.3, 0.3, 2.3]),
        ([-2.3, -0.2, 2.1], [-0.3, 0.2, 2.2]),
        ([0.3, -0.2, 2.1], [2.3, 0.2, 2.2]),
    )
    place = np.concatenate([draw.uniform(*box, (500, 3)) for box in boxes])
    each = np.repeat(np.arange(4), 500)
    spread = np.array([0.04, 0.04, 1.5, 1.5])[each]
    look = np.array([0.0, 0.2, 2.0, 2.4])[each] + spread * draw.standard_normal(len(each))
    blocks = [FeatureBlock(look[:, None], 1.0), FeatureBlock(np.eye(4)[each], 1.0, tells=False)]
    found = find_segments(place, blocks, SegmentSettings(samples=2000, least_cluster=0.05))
    assert adjusted_rand_score(np.minimum(each, 2), found) > 0.95
