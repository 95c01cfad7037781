"""Filling part meshes with quadrature points: counts, volumes and moments against closed form."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from mphygs.scene.particles import Quadrature, fill, fill_each, inside

SHARED = Path(__file__).resolve().parents[3] / "shared" / "data"
GAUSS = 0.5 / np.sqrt(3.0)


@dataclass(frozen=True)
class Solid:
    name: str
    vertices: np.ndarray
    faces: np.ndarray
    shape: str = "solid"


def solid(mesh: trimesh.Trimesh, name: str = "solid") -> Solid:
    return Solid(name, np.array(mesh.vertices, dtype=np.float64), np.array(mesh.faces, dtype=np.int64))


def box(low: list[float], high: list[float], name: str = "box") -> Solid:
    mesh = trimesh.creation.box(bounds=np.array([low, high]))
    return solid(mesh, name)


def turned(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    mesh.apply_transform(trimesh.transformations.rotation_matrix(0.7, [1.0, 2.0, -0.5]))
    mesh.apply_translation([0.013, -0.004, 0.021])
    return mesh


def moments(quadrature: Quadrature) -> tuple[float, np.ndarray, np.ndarray]:
    weight, points = quadrature.volumes, quadrature.points
    volume = weight.sum()
    mean = np.einsum("bk,bki->i", weight, points) / volume
    covariance = np.einsum("bk,bki,bkj->ij", weight, points - mean, points - mean) / volume
    return volume, mean, covariance


def in_cells(quadrature: Quadrature) -> np.ndarray:
    return (quadrature.points - quadrature.origin) / quadrature.spacing - quadrature.cell[:, None]


def practice(name: str) -> list[Solid]:
    folder = SHARED / "practice" / name
    if not folder.is_dir():
        pytest.skip(f"practice capture {name} is not beside this checkout")
    return [solid(trimesh.load(file), file.stem) for file in sorted(folder.glob("*.ply"))]


def test_full_cells_get_gauss_points() -> None:
    h = 0.004
    quadrature = fill([box([0.0, 0.0, 0.0], [3 * h, 2 * h, 4 * h])], spacing=h)
    assert len(quadrature.cell) == 24
    assert quadrature.node_shape.tolist() == [5, 4, 6]
    np.testing.assert_allclose(quadrature.origin, -0.5 * h, atol=1e-15)
    local = in_cells(quadrature)
    np.testing.assert_allclose(np.abs(local), GAUSS, atol=1e-9)
    np.testing.assert_allclose(local.mean(axis=1), 0.0, atol=1e-12)
    assert len(np.unique(np.sign(local[0]), axis=0)) == 8
    np.testing.assert_allclose(quadrature.volumes, h**3 / 8.0, rtol=1e-12)


def test_every_block_matches_the_moments_of_a_box_cut_anywhere() -> None:
    h, low, high = 0.01, np.array([0.001, 0.002, -0.003]), np.array([0.0242, 0.0267, 0.0313])
    quadrature = fill([box(low.tolist(), high.tolist())], spacing=h, origin_offset=(0.3, -0.2, 0.45))
    first = quadrature.origin + (quadrature.cell - 0.5) * h
    bottom, top = np.maximum(first, low), np.minimum(first + h, high)
    np.testing.assert_allclose(quadrature.volumes.sum(axis=1), (top - bottom).prod(axis=1), rtol=1e-9)
    np.testing.assert_allclose(quadrature.points.mean(axis=1), 0.5 * (bottom + top), atol=1e-9 * h)
    centred = quadrature.points - quadrature.points.mean(axis=1, keepdims=True)
    covariance = np.einsum("bki,bkj->bij", centred, centred) / 8.0
    expected = np.eye(3) * ((top - bottom) ** 2 / 12.0)[:, None, :]
    np.testing.assert_allclose(covariance, expected, atol=1e-9 * h**2)


@pytest.mark.parametrize(
    ("mesh", "covariance"),
    [
        (trimesh.creation.box(extents=[0.05, 0.02, 0.03]), np.diag([0.05**2, 0.02**2, 0.03**2]) / 12.0),
        (
            trimesh.creation.cylinder(radius=0.012, height=0.06, sections=256),
            np.diag([0.012**2 / 4.0, 0.012**2 / 4.0, 0.06**2 / 12.0]),
        ),
    ],
    ids=["box", "cylinder"],
)
def test_moments_of_a_turned_solid(mesh: trimesh.Trimesh, covariance: np.ndarray) -> None:
    mesh = mesh.copy()
    centre = turned(mesh).center_mass
    rotation = trimesh.transformations.rotation_matrix(0.7, [1.0, 2.0, -0.5])[:3, :3]
    expected = rotation @ covariance @ rotation.T
    quadrature = fill([solid(mesh)], spacing=0.005)
    volume, mean, found = moments(quadrature)
    assert volume == pytest.approx(mesh.volume, rel=1e-10)
    assert quadrature.free_volume[0] == pytest.approx(mesh.volume, rel=1e-12)
    np.testing.assert_allclose(mean, centre, atol=5e-3 * 0.005)
    # the 256-sided cylinder has itself moments smaller by 3e-4
    np.testing.assert_allclose(found, expected, atol=1e-3 * np.abs(expected).max())
    assert np.abs(in_cells(quadrature)).max() <= 0.5


def test_points_stay_in_cells_where_the_moments_alone_would_leave_them() -> None:
    # A plate in the corner of a cell with a thin needle through it: a small mean and a long tail.
    plate, needle = box([0.0, 0.0, 0.0], [0.001, 0.009, 0.009]), box([0.001, 0.0, 0.0], [0.01, 0.001, 0.001])
    faces = np.concatenate([plate.faces, needle.faces + 8])
    one = Solid("one", np.concatenate([plate.vertices, needle.vertices]), faces)
    quadrature = fill([one], spacing=0.01)
    local = in_cells(quadrature)[0]
    assert local[:, 0].min() == pytest.approx(-0.5, abs=1e-6)  # shrunk onto the boundary
    assert np.abs(local).max() <= 0.5
    volumes, middles = np.array([81e-9, 9e-9]), np.array([0.0005, 0.0055])
    mean = (volumes * middles).sum() / volumes.sum()
    assert quadrature.points[0, :, 0].mean() == pytest.approx(mean, rel=1e-9)


def test_hold_box_takes_exactly_its_volume() -> None:
    hold = np.array([[[-1.0, -1.0, -1.0], [0.0137, 1.0, 1.0]]])
    part = box([0.0, 0.0, 0.0], [0.05, 0.02, 0.03])
    quadrature = fill([part], spacing=0.006, exclude_boxes=hold)
    free = (0.05 - 0.0137) * 0.02 * 0.03
    assert quadrature.part_volume[0] == pytest.approx(3e-5, rel=1e-12)
    assert quadrature.free_volume[0] == pytest.approx(free, rel=1e-10)
    assert quadrature.volumes.sum() == pytest.approx(free, rel=1e-10)
    mean = moments(quadrature)[1]
    np.testing.assert_allclose(mean, [0.5 * (0.0137 + 0.05), 0.01, 0.015], rtol=1e-9)
    assert quadrature.points[:, :, 0].min() > 0.0137


def test_hold_box_cuts_columns_even_if_these_are_coarse() -> None:
    hold = np.array([[[-1.0, -1.0, -1.0], [0.0037, 1.0, 1.0]]])
    quadrature = fill([box([0.0, 0.0, 0.0], [0.01] * 3)], spacing=0.01, exclude_boxes=hold, samples=2)
    assert quadrature.free_volume[0] == pytest.approx(0.63e-6, rel=1e-10)


def test_boxes_that_overlap_are_taken_once() -> None:
    holds = np.array([[[-1.0, -1.0, -1.0], [0.01, 1.0, 1.0]], [[0.005, -1.0, -1.0], [0.02, 1.0, 1.0]]])
    quadrature = fill([box([0.0, 0.0, 0.0], [0.05, 0.02, 0.03])], spacing=0.006, exclude_boxes=holds)
    assert quadrature.free_volume[0] == pytest.approx(0.03 * 0.02 * 0.03, rel=1e-10)


def test_first_part_owns_an_overlap() -> None:
    left, right = box([0.0, 0.0, 0.0], [0.02, 0.01, 0.01]), box([0.015, 0.0, 0.0], [0.03, 0.01, 0.01])
    quadrature = fill([left, right], spacing=0.004)
    np.testing.assert_allclose(quadrature.free_volume, [2e-6, 1e-6], rtol=1e-9)
    np.testing.assert_allclose(quadrature.part_volume, [2e-6, 1.5e-6], rtol=1e-12)
    assert quadrature.points[quadrature.part == 1][:, :, 0].min() > 0.02
    swapped = fill([right, left], spacing=0.004)
    np.testing.assert_allclose(swapped.free_volume, [1.5e-6, 1.5e-6], rtol=1e-9)


def test_slivers_are_dropped_and_their_volume_kept() -> None:
    h = 0.01
    part = box([0.0, 0.0, 0.0], [2 * h + 5e-5 * h, h, h])
    quadrature = fill([part], spacing=h)
    assert len(quadrature.cell) == 2
    assert quadrature.volumes.sum() == pytest.approx((2 + 5e-5) * h**3, rel=1e-10)
    assert len(fill([box([0.0, 0.0, 0.0], [2.001 * h, h, h])], spacing=h).cell) == 3


def test_offset_moves_the_grid_and_covers_the_solid() -> None:
    h, part = 0.004, box([0.0, 0.0, 0.0], [0.01, 0.01, 0.01])
    for offset in ([0.25, -0.3, 0.9], [1.25, 2.7, -0.1]):
        quadrature = fill([part], spacing=h, origin_offset=offset)
        shift = (quadrature.origin / h + 0.5 - np.array(offset)) % 1.0
        np.testing.assert_allclose(np.minimum(shift, 1.0 - shift), 0.0, atol=1e-9)
        assert quadrature.cell.min() >= 1
        assert np.all(quadrature.cell + 1 < quadrature.node_shape)
        assert quadrature.volumes.sum() == pytest.approx(1e-6, rel=1e-10)


def test_grids_that_fit_have_boundaries_at_the_material_and_where_it_is_gripped() -> None:
    h = 0.004
    parts = [box([0.0, 0.0, 0.0], [0.01, 0.0127, 0.001]), box([0.005, 0.0, 0.0], [0.03, 0.0127, 0.02])]
    held = np.array([[[-1.0, -1.0, -1.0], [0.0015, 1.0, 1.0]]])
    q = fill_each(parts, spacing=h, exclude_boxes=held, planes={(1, 2): 0.013})
    # The first owns what both have; of the second what is left is one box less a corner.
    np.testing.assert_allclose(q.spacings[0], [0.0085 / 2, 0.0127 / 3, 0.75 * h], rtol=1e-9)
    np.testing.assert_allclose(q.spacings[1], [0.025 / 6, 0.0127 / 3, 0.013 / 3], rtol=1e-9)
    volume = [q.volumes[q.part == p].sum() for p in (0, 1)]
    shared = 0.005 * 0.0127 * 0.001
    np.testing.assert_allclose(volume, [0.0085 * 0.0127 * 0.001, 0.025 * 0.0127 * 0.02 - shared])
    boundary = (0.013 - q.origins[1, 2]) / q.spacings[1, 2] + 0.5
    assert boundary == pytest.approx(round(boundary), abs=1e-9)
    # Thinner than the least cell: in its middle.
    thin = q.points[q.part == 0][..., 2].mean()
    assert thin == pytest.approx(q.origins[0, 2] + q.spacings[0, 2] * q.cell[q.part == 0][0, 2], abs=1e-12)


def test_rays_through_edges_and_vertices_are_no_trouble() -> None:
    # Vertices of a subdivided box on every column of the grid, and a sphere with its poles on one.
    mesh = trimesh.creation.box(bounds=[[0.0, 0.0, 0.0], [0.02, 0.02, 0.02]])
    for _ in range(4):
        mesh = mesh.subdivide()
    quadrature = fill([solid(mesh)], spacing=0.02, samples=16, origin_offset=(1 / 32, 1 / 32, 0.0))
    assert quadrature.volumes.sum() == pytest.approx(8e-6, rel=1e-10)
    ball = fill([solid(trimesh.creation.uv_sphere(radius=0.01, count=[16, 16]))], spacing=0.005, samples=5)
    np.testing.assert_allclose(moments(ball)[1], 0.0, atol=1e-5)


def test_practice_flower_is_filled_exactly_and_fast() -> None:
    parts = practice("p1")
    held = np.array([[[-0.013, -0.013, -0.001], [0.013, 0.013, 0.006]]])
    start = time.process_time()
    quadrature = fill(parts, spacing=0.006, exclude_boxes=held)
    assert time.process_time() - start < 1.0
    found = np.bincount(quadrature.part, weights=quadrature.volumes.sum(axis=1))
    np.testing.assert_allclose(found, quadrature.free_volume, rtol=1e-10)
    expected = np.array([trimesh.Trimesh(part.vertices, part.faces).volume for part in parts])
    np.testing.assert_allclose(quadrature.part_volume, expected, rtol=1e-10)
    assert np.abs(in_cells(quadrature)).max() <= 0.5
    for number, part in enumerate(parts):
        centres = quadrature.points[quadrature.part == number].mean(axis=1)
        full = quadrature.volumes[quadrature.part == number].sum(axis=1) > 0.9 * 0.006**3
        assert inside(part, centres[full]).all()


def test_inside_agrees_with_closed_form() -> None:
    random = np.random.default_rng(3)
    part = box([0.0, 0.0, 0.0], [0.02, 0.03, 0.01])
    points = random.uniform(-0.01, 0.04, size=(20000, 3))
    expected = np.all((points > 0.0) & (points < [0.02, 0.03, 0.01]), axis=1)
    assert np.array_equal(inside(part, points), expected)
    lattice = np.stack(np.meshgrid(*[np.linspace(0.001, 0.009, 9)] * 3), axis=-1).reshape(-1, 3)
    assert inside(part, lattice).all()
    assert inside(part, points[:1]).tolist() == expected[:1].tolist()
    assert inside(part, np.empty((0, 3))).shape == (0,)
    ring = trimesh.creation.torus(0.02, 0.006, 64, 32)
    in_tube, in_hole = [0.0, 0.02, 0.003], [0.0, 0.0, 0.0]
    assert inside(solid(ring), np.array([in_tube, in_hole])).tolist() == [True, False]


def test_bad_input_is_named() -> None:
    part = box([0.0, 0.0, 0.0], [0.01, 0.01, 0.01], name="stem")
    with pytest.raises(ValueError, match="spacing: got -1"):
        fill([part], spacing=-1.0)
    with pytest.raises(ValueError, match="parts: got none"):
        fill([], spacing=0.01)
    with pytest.raises(ValueError, match="samples: got 0"):
        fill([part], spacing=0.01, samples=0)
    with pytest.raises(ValueError, match="origin_offset"):
        fill([part], spacing=0.01, origin_offset=(0.0, 0.0))
    with pytest.raises(ValueError, match=r"exclude_boxes: expected an \(H, 2, 3\)"):
        fill([part], spacing=0.01, exclude_boxes=np.zeros((2, 3)))
    with pytest.raises(ValueError, match="box 0 needs its lower corner first"):
        fill([part], spacing=0.01, exclude_boxes=np.array([[[1.0, 0, 0], [0, 1, 1]]]))
    with pytest.raises(ValueError, match="hold all material"):
        fill([part], spacing=0.01, exclude_boxes=np.array([[[-1.0, -1, -1], [1, 1, 1]]]))
    with pytest.raises(ValueError, match="part 'stem'.*closed surface"):
        lidless = part.faces[part.vertices[part.faces][:, :, 2].min(axis=1) < 0.005]
        fill([replace(part, faces=lidless)], spacing=0.01)
    with pytest.raises(ValueError, match="part 'stem': no cell of 1.0 m"):
        fill([part], spacing=1.0)
    with pytest.raises(ValueError, match="too fine"):
        fill([part], spacing=1e-6)
    with pytest.raises(ValueError, match="points: row 1 is not finite"):
        inside(part, np.array([[0.0, 0.0, 0.0], [np.nan, 0.0, 0.0]]))
    with pytest.raises(ValueError, match=r"points: expected an \(N, 3\)"):
        inside(part, np.zeros(3))
