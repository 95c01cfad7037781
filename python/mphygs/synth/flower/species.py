"""A species: shape, materials and colours of one kind of flower, frozen."""

from __future__ import annotations

from dataclasses import dataclass

from mphygs.synth.flower.blade import Outline
from mphygs.synth.flower.paint import BladePaint, RoundPaint

GREEN, PALE_GREEN = (0.30, 0.52, 0.20), (0.55, 0.70, 0.38)
LEAF = BladePaint(GREEN, (0.36, 0.60, 0.24), PALE_GREEN, veins=9.0, branched=True)
STEM = RoundPaint(GREEN, GREEN)


@dataclass(frozen=True)
class Tissue:
    """Young's modulus [Pa] and density [kg/m^3]; both vary with the seed."""

    youngs_modulus: float
    density: float


@dataclass(frozen=True)
class Whorl:
    """Petals of one ring. count: of them; columns: of the receptacle's that each grows from; turn: share of
    the angle between neighbours by which the ring is turned; vary: how unlike they are."""

    part: str
    count: int
    outline: Outline
    paint: BladePaint
    substance: Tissue
    columns: int = 4
    turn: float = 0.0
    vary: float = 0.08


@dataclass(frozen=True)
class LeafAt:
    """A leaf. level: share of the stem's height; bearing: angle about the stem [degree]."""

    level: float
    bearing: float
    outline: Outline


@dataclass(frozen=True)
class Species:
    """One kind of flower.

    stem: length of the stem's line [m]; radius, top_radius: of it [m]; lean: by which it bends [degree];
    sides: vertices of its rings; receptacle: radius [m]; flare: height from stem to petals [m]; dome: height
    above the petals [m]; columns: vertices of the receptacle's rings, a multiple of sides and of the petals
    of each whorl.
    """

    name: str
    whorls: tuple[Whorl, ...]
    leaves: tuple[LeafAt, ...]
    centre: RoundPaint
    stem: float = 0.078
    radius: float = 0.0045
    top_radius: float = 0.0036
    lean: float = 8.0
    sides: int = 12
    columns: int = 48
    receptacle: float = 0.008
    flare: float = 0.005
    dome: float = 0.005
    poissons_ratio: float = 0.35
    stem_substance: Tissue = Tissue(8e5, 420.0)
    centre_substance: Tissue = Tissue(1.5e5, 350.0)
    leaf_substance: Tissue = Tissue(3.5e5, 320.0)
    leaf_paint: BladePaint = LEAF
    stem_paint: RoundPaint = STEM

    @property
    def part_names(self) -> tuple[str, ...]:
        """stem, receptacle, leaves where there are any, and the whorls of petals."""
        leaves = ("leaves",) if self.leaves else ()
        return ("stem", "receptacle", *leaves, *(w.part for w in self.whorls))
