"""From a species and a seed to a flower: closed surfaces that meet exactly, materials, what is held."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mphygs.capture.meshes import Part
from mphygs.synth.flower.blade import blade
from mphygs.synth.flower.paint import BladePaint, RoundPaint
from mphygs.synth.flower.species import Species, Tissue
from mphygs.synth.flower.stalk import (
    Rings,
    bent_rings,
    receptacle_rings,
    receptacle_surface,
    stem_surface,
)
from mphygs.synth.flower.textured_surface import Surface, joined_surfaces
from mphygs.synth.recipe import Material
from mphygs.synth.shape import Shape

STEM_STEP = 0.0022  # between rings of a stem, the height of a leaf's root [m]
PETAL_ROOT = 0.0021  # height of a petal's root [m]
BETWEEN_WHORLS = 0.0016  # [m]
HELD = 0.16  # share of the stem's height that a hand holds
LEAF_COLUMNS = 3


@dataclass(frozen=True, eq=False)
class Flower:
    """A flower at rest. surfaces, paints: by part, in the order of the species' part names; shape: what the
    rest of synth knows of it; materials: by part."""

    species: Species
    surfaces: dict[str, Surface]
    paints: dict[str, BladePaint | RoundPaint]
    shape: Shape
    materials: dict[str, Material]


def grow(kind: Species, seed: int, *, spread: float = 0.15) -> Flower:
    """The flower of a species that a seed makes; spread: of the logarithms of its materials."""
    generator = np.random.default_rng([seed, 11])
    stem = bent_rings(
        height=kind.stem,
        radius=kind.radius,
        top_radius=kind.top_radius,
        lean=kind.lean + 3.0 * generator.standard_normal(),
        count=kind.sides,
        step=STEM_STEP,
    )
    profile, roots, top = _profile(kind)
    head = receptacle_rings(stem, profile, kind.columns)
    surfaces = {"stem": stem_surface(stem), "receptacle": receptacle_surface(stem, head, top)}
    paints: dict[str, BladePaint | RoundPaint] = {"stem": kind.stem_paint, "receptacle": kind.centre}
    if kind.leaves:
        surfaces["leaves"] = joined_surfaces(
            [_leaf(kind, stem, n, generator) for n in range(len(kind.leaves))]
        )
        paints["leaves"] = kind.leaf_paint
    for whorl, ring in zip(kind.whorls, roots, strict=True):
        each = kind.columns // whorl.count
        first = round(whorl.turn * each)
        surfaces[whorl.part] = joined_surfaces(
            [
                blade(
                    head.root(ring, first + k * each, whorl.columns, wedge=np.pi / whorl.count, gap=0.0014),
                    whorl.outline.varied(generator, whorl.vary),
                    k,
                )
                for k in range(whorl.count)
            ]
        )
        paints[whorl.part] = whorl.paint
    substances = _substances(kind)
    shape = _shape(kind, surfaces, stem, substances)
    materials = {}
    for name in kind.part_names:
        stiff, dense = np.exp(spread * generator.standard_normal(2))
        materials[name] = Material(
            float(f"{substances[name].youngs_modulus * stiff:.3g}"),
            float(f"{substances[name].density * dense:.3g}"),
            kind.poissons_ratio,
        )
    return Flower(kind, surfaces, paints, shape, materials)


def _profile(kind: Species) -> tuple[np.ndarray, list[int], float]:
    """Rings of the receptacle (S, 2) radius and height [m], the ring below each whorl, its whole height."""
    wide, narrow = kind.receptacle, 1.12 * kind.top_radius
    profile = [(narrow, 0.0), (narrow + 0.75 * (wide - narrow), 0.55 * kind.flare), (wide, kind.flare)]
    roots, radius, height = [], wide, kind.flare
    for number in range(len(kind.whorls)):
        if number:
            radius, height = radius - 0.0006, height + BETWEEN_WHORLS
            profile.append((radius, height))
        roots.append(len(profile) - 1)
        height += PETAL_ROOT
        profile.append((radius, height))
    for angle in np.radians([25.0, 50.0, 72.0]):
        profile.append((radius * np.cos(angle), height + kind.dome * np.sin(angle)))
    return np.array(profile), roots, height + kind.dome


def _leaf(kind: Species, stem: Rings, number: int, generator: np.random.Generator) -> Surface:
    at = kind.leaves[number]
    ring = round(at.level * (len(stem.points) - 1))
    first = round(at.bearing / 360.0 * kind.sides - 0.5 * LEAF_COLUMNS)
    root = stem.root(ring, first, LEAF_COLUMNS, wedge=None, gap=0.0)
    return blade(root, at.outline.varied(generator, 0.08), number)


def _substances(kind: Species) -> dict[str, Tissue]:
    return {
        "stem": kind.stem_substance,
        "receptacle": kind.centre_substance,
        "leaves": kind.leaf_substance,
    } | {w.part: w.substance for w in kind.whorls}


def _shape(
    kind: Species, surfaces: dict[str, Surface], stem: Rings, substances: dict[str, Tissue]
) -> Shape:
    level = HELD * float(stem.centre[:, 2].max())
    beside = 2.0 * kind.radius
    tip = surfaces["receptacle"].vertices[-1]
    return Shape(
        name=kind.name,
        parts=tuple(Part(n, surfaces[n].vertices, surfaces[n].faces) for n in kind.part_names),
        hold=np.array([[-beside, -beside, -1e-3], [beside, beside, level]]),
        pivot=np.array([0.0, 0.0, 0.5 * level]),
        axis=np.array([0.0, 0.0, 1.0]),
        # just below the surface, so that it lies in the material
        tip=tip - 1e-3 * stem.up[-1],
        gravity=np.array([0.0, 0.0, -9.81]),
        rest="equilibrium",
        youngs_modulus={n: substances[n].youngs_modulus for n in kind.part_names},
        density={n: substances[n].density for n in kind.part_names},
    )
