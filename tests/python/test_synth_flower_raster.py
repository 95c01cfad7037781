"""The mesh renderer against what is known: outlines, depths, what hides what, places that project back."""

import numpy as np
import pytest
import trimesh

from mphygs.capture.cameras import Camera, looking_at
from mphygs.synth.flower import raster
from mphygs.synth.flower.raster import averaged, hits, vertex_normals

CENTRE = np.array([0.01, -0.02, 0.03])


def camera(size: int = 64, distance: float = 0.4) -> Camera:
    place = CENTRE + distance * np.array([0.6, 0.64, 0.48])
    focal = np.full(2, 3.0 * size)
    return Camera("one", size, size, focal, np.full(2, size / 2), looking_at(place, CENTRE))


def ball(radius: float = 0.05, centre: np.ndarray = CENTRE) -> trimesh.Trimesh:
    return trimesh.creation.icosphere(subdivisions=4, radius=radius).apply_translation(centre)


def test_a_ball_has_the_outline_and_depth_of_a_ball() -> None:
    mesh, one = ball(), camera()
    seen = hits(one, mesh.vertices, mesh.faces, samples=2)
    mask = averaged(np.ones((len(seen.face), 1)), seen, 2)[..., 0]
    # the cone that touches the ball: tan = r / sqrt(d^2 - r^2)
    radius = 192.0 * 0.05 / np.sqrt(0.4**2 - 0.05**2)
    assert mask.sum() == pytest.approx(np.pi * radius**2, rel=0.01)
    assert mask.max() == 1.0 and ((mask > 0) & (mask < 1)).any()
    assert seen.depth.min() == pytest.approx(0.35, abs=2e-4)
    assert np.isinf(seen.depth_picture()[0, 0])


def test_places_seen_project_to_the_samples_they_are_seen_at() -> None:
    mesh, one = ball(), camera()
    seen = hits(one, mesh.vertices, mesh.faces, samples=2)
    places = seen.of_corners(mesh.vertices, mesh.faces)
    pixel, depth = one.project(places)
    rows, columns = np.divmod(seen.sample, 128)
    expected = (np.column_stack([columns, rows]) + 0.5) / 2
    assert np.abs(pixel - expected).max() < 1e-9
    assert depth == pytest.approx(seen.depth, rel=1e-12)


def test_the_nearer_of_two_balls_hides_the_other_whatever_their_order() -> None:
    one = camera()
    towards = one.position - CENTRE
    near, far = ball(0.02, CENTRE + 0.3 * towards), ball(0.05)
    for first, second, own in ((near, far, 0), (far, near, 1)):
        both = trimesh.util.concatenate([first, second])
        seen = hits(one, both.vertices, both.faces, samples=1)
        middle = seen.face[seen.sample == 32 * 64 + 32]
        assert (middle[0] >= len(first.faces)) == bool(own)


def test_small_pieces_of_work_give_the_same_picture(monkeypatch) -> None:
    mesh, one = ball(), camera()
    whole = hits(one, mesh.vertices, mesh.faces, samples=2)
    monkeypatch.setattr(raster, "_AT_ONCE", 700)
    pieces = hits(one, mesh.vertices, mesh.faces, samples=2)
    assert np.array_equal(whole.face, pieces.face) and np.array_equal(whole.depth, pieces.depth)


def test_backs_are_not_drawn_and_a_surface_behind_the_camera_is_refused() -> None:
    mesh, one = ball(), camera()
    inner = hits(one, mesh.vertices, mesh.faces[:, ::-1], samples=1)
    # turned inside out, the far half is what faces the camera
    assert inner.depth.min() > 0.38
    with pytest.raises(ValueError, match="reaches behind"):
        hits(camera(distance=0.04), mesh.vertices, mesh.faces, samples=1)


def test_normals_of_a_ball_point_outward() -> None:
    mesh = ball()
    normal = vertex_normals(mesh.vertices, mesh.faces)
    assert np.einsum("nc,nc->n", normal, (mesh.vertices - CENTRE) / 0.05).min() > 0.999
