"""How thick a rod or a shell is, where that is not known: as modulus and density on its mesh's section.

A section that is thicker by a factor k bends as the mesh's own does with E k^3 and weighs as with rho k; one
of a rod, larger by k both ways, with E k^4 and rho k^2 (Timoshenko and Woinowsky-Krieger, "Theory of Plates
and Shells", 1959, eq. 3; Timoshenko, "Strength of Materials"). What is thin bends and hardly stretches: this
is what a motion shows of a thickness, drag on the surface and loads as they are. What it leaves out is of the
order of the thickness over the length, and that a rod's surface grows with k.
"""

from __future__ import annotations

from mphygs.capture.meshes import Part
from mphygs.model.belief import Belief, Parameter
from mphygs.scene.curved_quadrature import thickness_of

QUANTITY = "thickness"
# Of E and of the density, by what a part is simulated as.
POWERS = {"shell": (3.0, 1.0), "rod": (4.0, 2.0)}


def section_factors(belief: Belief, part: Part) -> tuple[float, float]:
    """What E and the density of a part are to be multiplied by for its thickness in a belief: 1 where that is
    the mesh's."""
    key = f"{part.name}.{QUANTITY}"
    if part.shape not in POWERS or key not in belief:
        return 1.0, 1.0
    ratio = belief[key].value / thickness_of(part)
    of_modulus, of_density = POWERS[part.shape]
    return ratio**of_modulus, ratio**of_density


def mass_power(parameter: Parameter, part: Part) -> float:
    """The power of a parameter, fitted in its logarithm, that a part's mass goes with."""
    name, quantity = parameter.key.rsplit(".", 1)
    if name != part.name:
        return 0.0
    return {"density": 1.0, QUANTITY: POWERS.get(part.shape, (0.0, 0.0))[1]}.get(quantity, 0.0)


def part_mass(belief: Belief, part: Part) -> float:
    """Mass of a part as a belief has it [kg]."""
    return belief[f"{part.name}.density"].value * part.volume * section_factors(belief, part)[1]
