"""Part meshes: closed, outward, in metres, or refused with one line."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

import mphygs
from mphygs.capture.document import Entry
from mphygs.capture.errors import CaptureError
from mphygs.capture.meshes import Part, read_mesh, read_part, write_mesh
from thin_meshes import held_capture, strip


def cube(centre: float = 0.0, size: float = 1.0) -> trimesh.Trimesh:
    mesh = trimesh.creation.box(extents=(size, size, size))
    mesh.apply_translation((centre, 0, 0))
    return mesh


def stored(tmp_path: Path, mesh: trimesh.Trimesh, name: str = "m.ply") -> Path:
    path = tmp_path / name
    write_mesh(path, np.array(mesh.vertices), np.array(mesh.faces))
    return path


def signed_volume(path: Path) -> float:
    vertices, faces = read_mesh(path)
    return Part("m", vertices, faces).volume


def complaint(path: Path) -> str:
    with pytest.raises(CaptureError) as caught:
        read_mesh(path)
    line = str(caught.value)
    assert line.startswith(str(path)) and "\n" not in line and "expected a closed" in line
    return line


@pytest.mark.parametrize("ending", ["ply", "stl", "obj", "off", "glb"])
def test_formats_give_the_same_merged_solid(tmp_path: Path, ending: str) -> None:
    path = tmp_path / f"m.{ending}"
    trimesh.creation.icosphere(subdivisions=2, radius=0.03).export(path)
    vertices, faces = read_mesh(path)
    assert vertices.shape == (162, 3) and faces.shape == (320, 3)
    assert vertices.dtype == np.float64 and faces.dtype == np.int64
    assert np.isclose(Part("m", vertices, faces).volume, 4 / 3 * np.pi * 0.03**3, rtol=0.06)


def test_written_mesh_reads_back_bit_for_bit(tmp_path: Path) -> None:
    ball = trimesh.creation.icosphere(subdivisions=2, radius=1 / 3)
    vertices, faces = read_mesh(stored(tmp_path, ball))
    assert np.array_equal(vertices, ball.vertices) and np.array_equal(faces, ball.faces)


def test_inward_surfaces_are_turned_outward(tmp_path: Path) -> None:
    mesh = cube()
    mesh.invert()
    assert np.isclose(signed_volume(stored(tmp_path, mesh)), 1.0)


def test_one_inward_body_of_two_is_turned_and_a_cavity_is_kept(tmp_path: Path) -> None:
    inward = cube(5.0, 0.5)
    inward.invert()
    assert np.isclose(signed_volume(stored(tmp_path, trimesh.util.concatenate([cube(), inward]))), 1.125)
    cavity = cube(0.0, 0.5)
    cavity.invert()
    assert np.isclose(signed_volume(stored(tmp_path, trimesh.util.concatenate([cube(), cavity]))), 0.875)


def refused(path: Path) -> str:
    with pytest.raises(CaptureError) as caught:
        read_mesh(path)
    line = str(caught.value)
    assert line.startswith(str(path)) and "\n" not in line and "expected every piece of material once" in line
    return line


@pytest.mark.parametrize("ending", ["ply", "stl"])
def test_a_body_given_twice_in_other_triangles(ending: str, tmp_path: Path) -> None:
    path = tmp_path / f"m.{ending}"
    trimesh.util.concatenate([cube(), cube().subdivide()]).export(path)
    line = refused(path)
    # an .stl has no vertices of its own: the two become one
    words = {"ply": "overlaps others with 100% of its volume", "stl": "goes 2 times round its volume"}
    assert words[ending] in line


def test_bodies_that_overlap_are_refused_by_how_much(tmp_path: Path) -> None:
    ball = trimesh.creation.icosphere(subdivisions=3, radius=0.5)
    ball.apply_translation((0.5, 0.013, 0.021))
    both = stored(tmp_path, trimesh.util.concatenate([cube(), ball, cube(9.0)]))
    assert "body 2 of 3, about (0.5, 0.013, 0.021), overlaps others with 5" in refused(both)
    # Stuck into one another by less than what counts.
    assert np.isclose(signed_volume(stored(tmp_path, trimesh.util.concatenate([cube(), cube(0.99)]))), 2.0)


def test_a_wall_around_a_core_in_a_cavity_is_material_once(tmp_path: Path) -> None:
    cavity = cube(0.0, 0.6)
    cavity.invert()
    nested = trimesh.util.concatenate([cube(), cavity, cube(0.0, 0.2)])
    assert np.isclose(signed_volume(stored(tmp_path, nested)), 1 - 0.6**3 + 0.2**3)


@pytest.mark.parametrize("end", ["endsolid", "end solid", "endsolid a", "ENDSOLID"])
def test_text_stl_of_several_solids_ends_as_it_likes(end: str, tmp_path: Path) -> None:
    lines = []
    for centre in (0.0, 2.0):
        lines.append("solid")
        for triangle in cube(centre).triangles:
            lines += ["facet normal 0 0 0", "outer loop", *(f"vertex {x} {y} {z}" for x, y, z in triangle)]
            lines += ["endloop", "endfacet"]
        lines.append(end)
    (tmp_path / "m.stl").write_text("\n".join(lines) + "\n")
    assert np.isclose(signed_volume(tmp_path / "m.stl"), 2.0)


def test_mixed_winding_is_repaired(tmp_path: Path) -> None:
    mesh = cube()
    mesh.faces[3] = mesh.faces[3][::-1]
    assert np.isclose(signed_volume(stored(tmp_path, mesh)), 1.0)


def test_voxels_that_touch_along_an_edge_are_closed(tmp_path: Path) -> None:
    other = cube()
    other.apply_translation((1, 1, 0))
    both = trimesh.util.concatenate([cube(), other])
    both.merge_vertices()
    assert len(both.vertices) == 14 and not both.is_watertight
    assert np.isclose(signed_volume(stored(tmp_path, both)), 2.0)


def test_unused_vertices_and_degenerate_faces_are_dropped(tmp_path: Path) -> None:
    mesh = cube()
    faces = np.concatenate([mesh.faces, [[0, 0, 1]]])
    path = tmp_path / "m.ply"
    write_mesh(path, np.concatenate([mesh.vertices, [[9.0, 9, 9]]]), faces)
    vertices, faces = read_mesh(path)
    assert vertices.shape == (8, 3) and faces.shape == (12, 3)


def test_open_surface_says_where(tmp_path: Path) -> None:
    mesh = cube()
    mesh.update_faces(np.arange(12) > 0)
    assert "is not closed: 3 open edges, one at (" in complaint(stored(tmp_path, mesh))


def test_flat_surface_encloses_nothing(tmp_path: Path) -> None:
    path = tmp_path / "m.ply"
    write_mesh(path, np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]), np.array([[0, 1, 2], [0, 2, 1]]))
    assert "encloses no volume" in complaint(path)


def test_moebius_band_sealed_to_itself_has_no_inside(tmp_path: Path) -> None:
    # the projective plane of six vertices: every edge has two faces, no winding is possible
    faces = np.array(
        [
            [0, 1, 2],
            [0, 2, 3],
            [0, 3, 4],
            [0, 4, 5],
            [0, 5, 1],
            [1, 2, 4],
            [2, 3, 5],
            [3, 4, 1],
            [4, 5, 2],
            [5, 1, 3],
        ]
    )
    path = tmp_path / "m.ply"
    write_mesh(path, np.random.default_rng(0).standard_normal((6, 3)), faces)
    assert "no inside and outside" in complaint(path)


def test_damaged_files(tmp_path: Path) -> None:
    path = stored(tmp_path, cube())
    whole = path.read_bytes()
    for size in (0, 40, len(whole) // 2, len(whole) - 5):
        path.write_bytes(whole[:size])
        assert "truncated" in complaint(path)
    vertices = np.array(cube().vertices)
    vertices[5, 1] = np.nan
    write_mesh(path, vertices, np.array(cube().faces))
    assert "vertex 5: is not finite" in complaint(path)
    write_mesh(path, vertices[:3], np.array(cube().faces))
    assert "expected" in complaint(path)
    plain = tmp_path / "mesh"
    plain.write_bytes(whole)
    assert "has no file ending" in complaint(plain)
    odd = tmp_path / "mesh.xyzzy"
    odd.write_bytes(whole)
    assert "cannot be read as a mesh" in complaint(odd)


def test_points_without_faces(tmp_path: Path) -> None:
    path = tmp_path / "m.ply"
    trimesh.PointCloud(np.random.default_rng(0).standard_normal((9, 3))).export(path)
    complaint(path)


def test_read_part_scales_to_metres(tmp_path: Path) -> None:
    stored(tmp_path, cube(size=20.0))
    part = read_part(tmp_path, Entry({"name": "p", "mesh": "m.ply", "scale": 1e-3}, "f", "part"))
    assert part.name == "p" and np.isclose(part.volume, 8e-6)
    assert np.allclose(part.bounds, [[-0.01] * 3, [0.01] * 3])


@pytest.mark.parametrize("scale", [0, -1.0])
def test_read_part_refuses_a_scale_of_zero(tmp_path: Path, scale: float) -> None:
    stored(tmp_path, cube())
    with pytest.raises(CaptureError, match=r"f: part.scale: is .*; expected a number above zero"):
        read_part(tmp_path, Entry({"name": "p", "mesh": "m.ply", "scale": scale}, "f", "part"))


@pytest.mark.parametrize("index", [-5, 99])
def test_a_face_that_names_no_vertex_is_told_by_it(index: int, tmp_path: Path) -> None:
    box = trimesh.creation.box(extents=[0.02] * 3)
    header = ["ply", "format ascii 1.0", "element vertex 8", *(f"property float {axis}" for axis in "xyz")]
    header += ["element face 12", "property list uchar int vertex_indices", "end_header"]
    faces = [*box.faces[:-1].tolist(), [0, 1, index]]
    rows = [*(" ".join(map(str, v)) for v in box.vertices), *(f"3 {a} {b} {c}" for a, b, c in faces)]
    (tmp_path / "a.ply").write_text("\n".join([*header, *rows]) + "\n")
    with pytest.raises(CaptureError, match=f"names vertex {index} of 8, counted from 0"):
        read_mesh(tmp_path / "a.ply")


@pytest.mark.parametrize("shape", ["solid", "auto", "rod", "shell"])
def test_a_part_may_say_what_it_is(tmp_path: Path, shape: str) -> None:
    stored(tmp_path, cube())
    part = read_part(tmp_path, Entry({"name": "a", "mesh": "m.ply", "as": shape}, "capture.json", "part"))
    assert np.isclose(part.volume, 1.0) and part.shape == shape


def bent_square(count: int = 9) -> trimesh.Trimesh:
    """A middle surface that bends: its rim is open."""
    u = np.linspace(0.0, 1.0, count)
    x, y = np.meshgrid(u, u, indexing="ij")
    place = np.stack([np.sin(x), y, 1.0 - np.cos(x)], axis=2).reshape(-1, 3)
    n = np.arange(count * count).reshape(count, count)
    a, b, c, d = (v.ravel() for v in (n[:-1, :-1], n[1:, :-1], n[1:, 1:], n[:-1, 1:]))
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    return trimesh.Trimesh(place, faces, process=False)


def test_a_middle_surface_is_given_its_thickness(tmp_path: Path) -> None:
    mesh = bent_square()
    mesh.faces[::3] = mesh.faces[::3, ::-1]  # whichever way its triangles are wound
    stored(tmp_path, mesh)
    entry = {"name": "a", "mesh": "m.ply", "thickness": 1e-5, "scale": 1e-3}
    part = read_part(tmp_path, Entry(entry, "capture.json", "part"))
    assert part.shape == "shell" and part.thickness_std == 0.0
    unsure = read_part(tmp_path, Entry(entry | {"thickness_std": 2e-6}, "capture.json", "part"))
    assert unsure.thickness_std == 2e-6
    assert part.volume == pytest.approx(1e-5 * mesh.area * 1e-6, rel=1e-3)
    assert trimesh.Trimesh(part.vertices, part.faces, process=False).is_volume


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ({"thickness": 0.0002}, "is closed, and has no middle surface"),
        ({"thickness": 0.0}, "part.thickness"),
        ({"thickness": 0.0002, "as": "rod"}, "a rod's mesh is closed"),
        ({"thickness_std": 1e-5}, 'the part is "as": "solid"; expected "as": "rod" or "shell" beside it'),
        ({"thickness_std": 1e-5, "as": "auto"}, "rod"),
        ({"thickness_std": -1e-5, "as": "shell"}, "part.thickness_std"),
        ({"as": "membrane"}, "expected one of solid, shell, rod, auto"),
    ],
)
def test_what_a_part_cannot_be_is_refused(tmp_path: Path, more: dict[str, object], message: str) -> None:
    stored(tmp_path, cube())
    with pytest.raises(CaptureError) as caught:
        read_part(tmp_path, Entry({"name": "a", "mesh": "m.ply", **more}, "capture.json", "part"))
    assert message in str(caught.value) and "\n" not in str(caught.value)


def test_a_thickness_in_another_unit_is_refused(tmp_path: Path) -> None:
    """A length in mm, which `scale` does not bring to metres, is wider than the sheet."""
    stored(tmp_path, bent_square())
    entry = Entry({"name": "a", "mesh": "m.ply", "thickness": 0.01, "scale": 1e-3}, "capture.json", "part")
    with pytest.raises(CaptureError, match=r"thickness: is 0\.01 m, of a sheet that is \S+ m wide; .*in m\?"):
        read_part(tmp_path, entry)


@pytest.mark.parametrize(
    "more",
    [
        {"shape": "Rod"},
        {"shape": None},
        {"shape": "shell", "thickness_std": float("nan")},
        {"shape": "shell", "thickness_std": -1e-5},
        {"shape": "shell", "thickness_std": "1e-5"},
        {"thickness_std": 1e-5},
    ],
)
def test_a_part_of_arrays_is_what_it_may_be(more: dict) -> None:
    with pytest.raises(ValueError, match=r"^part 'a': (shape|thickness_std) is .*; expected"):
        Part("a", np.array(cube().vertices), np.array(cube().faces), **more)


def test_a_capture_of_arrays_has_closed_meshes_and_a_thickness_that_can_be() -> None:
    sheet = strip()
    for part, message in (
        (replace(sheet, faces=sheet.faces[:-1]), r'parts\[0\]\.mesh: part "part0" is not closed; expected'),
        (replace(sheet, faces=sheet.faces[:, ::-1]), "encloses no volume, or is turned inward; expected"),
        (replace(sheet, faces=sheet.faces[:0]), "has no triangles; expected"),
        (replace(sheet, faces=sheet.faces + 1), "has faces with corners 1 to .*, of .* vertices; expected"),
        (replace(sheet, vertices=sheet.vertices * np.nan), "has vertices that are not finite; expected"),
        (replace(sheet, vertices=sheet.vertices[:, :2]), "has vertices of shape .*; expected"),
        (replace(sheet, thickness_std=0.03), r"parts\[0\]\.thickness_std: is 0\.03 m, .* thick; expected"),
    ):
        with pytest.raises(ValueError, match=message) as caught:
            mphygs.Model.of(held_capture([part], markers=np.array([[0.1, 0.0, 0.0]])), spacing=0.02)
        assert "\n" not in str(caught.value)


def test_a_fine_mesh_that_goes_twice_round_its_volume_is_refused(tmp_path: Path) -> None:
    ball = trimesh.creation.icosphere(subdivisions=5)
    # The same ball again, turned so that no triangle stands there twice, and sewn to it at one corner.
    turned = trimesh.transformations.rotation_matrix(0.3, ball.vertices[0])
    twice = trimesh.util.concatenate([ball, ball.copy().apply_transform(turned)])
    twice.merge_vertices()
    with pytest.raises(CaptureError, match="goes 2 times round its volume"):
        read_mesh(stored(tmp_path, twice))
    assert np.isclose(signed_volume(stored(tmp_path, ball)), 4 / 3 * np.pi, rtol=1e-2)
