"""Objects are closed, touch exactly, and are as large as they say."""

import numpy as np
import pytest
import trimesh

from mphygs.synth.shapes import SHAPES, flower, leaf_polygon, polygon, prism, rectangle, shape


@pytest.mark.parametrize("kind", SHAPES)
def test_parts_are_closed_and_outward(kind) -> None:
    for part in shape(kind).parts:
        mesh = trimesh.Trimesh(part.vertices, part.faces, process=False)
        assert mesh.is_watertight and mesh.is_winding_consistent
        assert mesh.volume > 0.0
        assert part.volume == pytest.approx(mesh.volume)


def test_volume_of_a_prism_is_area_times_length() -> None:
    for axis in range(3):
        assert prism("p", rectangle(2.0, 3.0), axis, 1.0, 5.0).volume == pytest.approx(24.0)
    octagon = 8.0 * np.tan(np.pi / 8.0)
    assert prism("p", polygon(1.0, 8), 2, 0.0, 1.0).volume == pytest.approx(octagon)
    assert prism("p", leaf_polygon(0.0, 1.0, 0.2, 0.1, -1), 2, 0.0, 1.0).volume > 0.0


@pytest.mark.parametrize("kind", ["two-part-bar", "flower", "hanging-flower"])
def test_parts_touch_without_gap_or_overlap(kind) -> None:
    parts = {part.name: part for part in shape(kind).parts}
    if kind == "two-part-bar":
        assert parts["lower"].bounds[1, 0] == parts["upper"].bounds[0, 0]
        return
    stem = parts["stem"]
    assert stem.bounds[1, 2] == parts["head"].bounds[0, 2]
    assert parts["leaf1"].bounds[0, 0] == pytest.approx(stem.bounds[1, 0], abs=1e-15)
    assert parts["leaf2"].bounds[1, 0] == pytest.approx(stem.bounds[0, 0], abs=1e-15)
    # A leaf's root is no wider than the side of the stem that it stands on.
    root = parts["leaf1"].vertices[np.isclose(parts["leaf1"].vertices[:, 0], stem.bounds[1, 0])]
    side = stem.vertices[np.isclose(stem.vertices[:, 0], stem.bounds[1, 0])]
    assert np.abs(root[:, 1]).max() <= np.abs(side[:, 1]).max() + 1e-12
    assert len(root) >= 4


@pytest.mark.parametrize("kind", SHAPES)
def test_tip_is_in_the_material_and_the_hold_leaves_it_free(kind) -> None:
    body = shape(kind)
    meshes = [trimesh.Trimesh(p.vertices, p.faces, process=False) for p in body.parts]
    assert any((body.tip >= m.bounds[0]).all() and (body.tip <= m.bounds[1]).all() for m in meshes)
    assert not ((body.tip >= body.hold[0]) & (body.tip <= body.hold[1])).all()
    for box in (body.hold, body.hold if body.far_hold is None else body.far_hold):
        gripped = [((p.vertices >= box[0]) & (p.vertices <= box[1])).all(axis=1) for p in body.parts]
        assert sum(g.any() for g in gripped) == 1
        (inside,) = (p.vertices[g] for p, g in zip(body.parts, gripped, strict=True) if g.any())
        # Round what it grips, but for the face that the free part goes out through.
        assert (np.stack([inside.min(0) - box[0], box[1] - inside.max(0)]) > 1e-6).sum() >= 5


def test_hanging_flower_hangs_and_names_are_checked() -> None:
    assert np.allclose(shape("hanging-flower").gravity, -flower().gravity)
    assert shape("bar", length=0.2).parts[0].bounds[1, 0] == 0.2
    with pytest.raises(ValueError, match="expected one of bar"):
        shape("pear")
    with pytest.raises(ValueError, match="wings"):
        shape("bar", wings=2.0)
