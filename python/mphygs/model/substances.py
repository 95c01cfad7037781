"""What soft things are usually made of: ranges of Young's modulus, as words beside a found one and as priors.

One table, with sources; a range is told somewhat wider than its source where that has single products.
  gel       polyacrylamide gels, 0.2 to 40 kPa: Tse and Engler, "Preparation of hydrogel substrates with
            tunable mechanical properties", Current Protocols in Cell Biology 10.16, 2010
  silicone  soft casting silicones, by their moduli at 100 % strain: Ecoflex 00-30 69 kPa, Dragon Skin 10
            151 kPa, Dragon Skin 30 593 kPa (the maker's data sheets); Sylgard 184, 1.3 to 3 MPa: Johnston
            et al., "Mechanical characterization of bulk Sylgard 184", J. Micromech. Microeng. 24, 2014
  rubber    natural rubber, 1.5 to 2.5 MPa: Ashby, "Materials Selection in Mechanical Design", 2011
  petal     soft plant tissue (parenchyma), from 0.3 MPa: Gibson, "The hierarchical structure and mechanics
            of plant materials", J. R. Soc. Interface 9, 2012; to 19 MPa where turgid: Niklas, "Dependency of
            the tensile modulus on transverse dimensions, water potential, and cell number of pith
            parenchyma", Am. J. Bot. 75, 1988
  stem      from such tissue to 1 GPa, short of the 30 GPa that Gibson 2012 gives for the densest palm
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase


@dataclass(frozen=True)
class Substance:
    """name: of the preset; words: what it is called; softest, stiffest: Young's moduli [Pa]; density [kg/m^3]
    where nothing is known of it."""

    name: str
    words: str
    softest: float
    stiffest: float
    density: float

    @property
    def median(self) -> float:
        """The middle of the range, in logarithms [Pa]."""
        return math.sqrt(self.softest * self.stiffest)

    @property
    def spread(self) -> float:
        """Standard deviation of the logarithm: the range is two of them to either side."""
        return 0.25 * math.log(self.stiffest / self.softest)


SUBSTANCES = (
    Substance("gel", "a gel", 2e2, 4e4, 1000.0),
    Substance("silicone", "silicone", 4e4, 3e6, 1070.0),
    Substance("rubber", "rubber", 1e6, 5e6, 930.0),
    Substance("petal", "soft plant tissue", 3e5, 2e7, 1000.0),
    Substance("stem", "a plant's stem", 3e5, 1e9, 1000.0),
)
# Below this a silicone is called soft: Shore 00 and Shore A 10.
SOFT = 2e5


def substance(name: str) -> Substance:
    """The substance of a preset. Raises KeyError, naming those there are."""
    for known in SUBSTANCES:
        if known.name == name:
            return known
    raise KeyError(f"unknown preset '{name}'; expected one of {', '.join(s.name for s in SUBSTANCES)}")


def substances_of(preset: str) -> list[tuple[str, Substance]]:
    """The entries of a preset, pattern of parts' names and substance: "stem" is for all parts,
    "stem=stem,petal*=petal" by part. Raises ValueError for an empty one, KeyError for a substance unknown."""
    entries = []
    for entry in preset.split(","):
        part, between, name = entry.rpartition("=")
        if not name.strip() or (between and not part.strip()):
            raise ValueError(f"got '{preset}'; expected a substance, or part=substance,part=substance")
        entries.append((part.strip() if between else "*", substance(name.strip())))
    return entries


def substances_by_part(preset: str, parts: Sequence[str]) -> dict[str, Substance]:
    """The substance of every part that a preset names, by the last entry that does.

    Raises ValueError where an entry names no part, and as `substances_of`.
    """
    found = {}
    for pattern, own in substances_of(preset):
        named = [part for part in parts if part == pattern or fnmatchcase(part, pattern)]
        if not named:
            raise ValueError(f"no part '{pattern}'; expected some of {', '.join(parts)}")
        found |= dict.fromkeys(named, own)
    return found


def like(youngs_modulus: float) -> str:
    """What has such a Young's modulus [Pa], in words."""
    found = [s for s in SUBSTANCES if s.softest <= youngs_modulus <= s.stiffest]
    if not found:
        softer = youngs_modulus < min(s.softest for s in SUBSTANCES)
        return "softer than any gel" if softer else "stiffer than anything soft"
    # the narrowest ranges say most
    names = [s.words for s in sorted(found, key=lambda s: s.spread)]
    soft = youngs_modulus < SOFT
    return "like " + " or ".join("soft silicone" if soft and n == "silicone" else n for n in names)
