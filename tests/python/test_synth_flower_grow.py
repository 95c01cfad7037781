"""Flowers of all species: closed parts that meet exactly and nowhere overlap."""

import numpy as np
import pytest

from mphygs.capture.meshes import enclosed_volume, read_mesh, write_mesh
from mphygs.capture.overlap import winding_number
from mphygs.scene.particles import fill
from mphygs.synth.flower import SPECIES, grow
from mphygs.synth.flower.catalogue import species


def triangles(part) -> set[tuple]:
    """Corners of all triangles, each from its lowest corner on."""
    found = set()
    for corners in part.vertices[part.faces]:
        rows = [tuple(c) for c in corners]
        first = rows.index(min(rows))
        found.add((*rows[first:], *rows[:first]))
    return found


@pytest.mark.parametrize("name", SPECIES)
def test_parts_are_closed_and_do_not_overlap(name, tmp_path) -> None:
    parts = grow(SPECIES[name], 5).shape.parts
    for part in parts:
        path = tmp_path / f"{part.name}.ply"
        write_mesh(path, part.vertices, part.faces)
        vertices, faces = read_mesh(path)
        assert np.array_equal(vertices, part.vertices) and np.array_equal(faces, part.faces)
        assert part.volume > 1e-8
    # Just below every few triangles of every part there is its own material, once, and no other's.
    for part in parts:
        a, b, c = np.moveaxis(part.vertices[part.faces[::7]], 1, 0)
        normal = np.cross(b - a, c - a)
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        below = (a + b + c) / 3 - 2e-5 * normal
        for other in parts:
            around = winding_number(below, other.vertices, other.faces)
            expected = 1.0 if other is part else 0.0
            assert np.abs(around - expected).max() < 1e-6, (part.name, other.name)


def test_filling_finds_the_volume_of_every_part() -> None:
    parts = grow(SPECIES["lotus"], 2).shape.parts
    filled = fill(parts, spacing=0.004)
    volumes = np.array([enclosed_volume(part.vertices, part.faces) for part in parts])
    # what an earlier part owned would be missing here
    assert filled.free_volume == pytest.approx(volumes, rel=2e-3)


def test_blades_and_the_receptacle_stand_on_the_very_triangles_of_what_carries_them() -> None:
    kind = SPECIES["anemone"]
    parts = {part.name: triangles(part) for part in grow(kind, 0).shape.parts}
    turned = {
        name: {(t[0], t[2], t[1]) for t in found}
        for name, found in parts.items()
    }  # fmt: skip
    petals = kind.whorls[0]
    assert len(parts["petals"] & turned["receptacle"]) == 2 * petals.columns * petals.count
    assert len(parts["receptacle"] & turned["stem"]) == kind.sides
    assert len(parts["leaves"] & turned["stem"]) == 2 * 3 * len(kind.leaves)


def test_species_are_many_and_unlike_in_shape_and_material() -> None:
    assert len(SPECIES) >= 10
    shapes = {(w.outline, w.count, kind.stem, kind.lean) for kind in SPECIES.values() for w in kind.whorls}
    assert len(shapes) == sum(len(kind.whorls) for kind in SPECIES.values())
    softest = {kind.whorls[0].substance for kind in SPECIES.values()}
    assert len(softest) >= 10
    with pytest.raises(ValueError, match="expected one of daisy"):
        species("cactus")


def test_the_seed_changes_growth_and_materials_and_nothing_else_does() -> None:
    one, same, other = (grow(SPECIES["poppy"], seed) for seed in (3, 3, 4))
    for a, b in zip(one.shape.parts, same.shape.parts, strict=True):
        assert np.array_equal(a.vertices, b.vertices)
    assert one.materials == same.materials != other.materials
    petals = [flower.surfaces["petals"].vertices for flower in (one, other)]
    assert 1e-4 < np.abs(petals[0] - petals[1]).max() < 0.02


def test_the_hold_takes_the_foot_of_the_stem_alone() -> None:
    for kind in SPECIES.values():
        shape = grow(kind, 1).shape
        for part in shape.parts:
            inside = ((part.vertices >= shape.hold[0]) & (part.vertices <= shape.hold[1])).all(axis=1)
            assert inside.any() == (part.name == "stem") and not inside.all(), (kind.name, part.name)
