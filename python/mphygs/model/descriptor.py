"""What an effect says of itself: where it acts, its numbers, and the part that each of them plays.

General code reads this and knows no effect by name. Effects in C++ say the same: see
cpp/include/mphygs/physics/descriptor.hpp.
"""

from __future__ import annotations

from dataclasses import dataclass

# The part that a number plays, and so how it is tried:
#   strength   how much of the effect there is: absent at its null, where the derivative tells of it
#   level      a positive number with a scale of its own (a time, a stress), tried on a logarithmic grid
#   direction  x, y or z, three in a row, of a vector of which only the direction counts
#   axis       the same where the sign does not count either, of length 1
#   flow       x, y or z of a velocity that another number, the strength, multiplies
#   anchor     x, y or z of a point in space that a material point is tied to
#   offset     of a plane direction . x = offset
#   frequency  [Hz]
#   phase      [rad] of that frequency
#   switch     0 or 1, each a form of the effect
#   constant   given by the user
VECTORS = ("direction", "axis", "flow", "anchor")
SCANNED = ("level", *VECTORS, "offset", "frequency", "phase", "switch")
ROLES = ("strength", *SCANNED, "constant")


@dataclass(frozen=True)
class ParameterSpec:
    """One number of an effect. null: value at which the effect is absent; scale: a usual size; fitted: False
    for a constant that the user gives.

    role: one of ROLES, by default "strength" where it is fitted, else "constant"; scan: where it is tried,
    from low to high (a level's grid, a flow's speed), None for about its scale. Raises ValueError for what
    does not go together.
    """

    name: str
    unit: str
    null: float
    lower: float
    upper: float
    scale: float
    fitted: bool = True
    role: str = ""
    scan: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        if not self.role:
            object.__setattr__(self, "role", "strength" if self.fitted else "constant")
        if self.role not in ROLES:
            raise ValueError(
                f"parameter {self.name}: role is {self.role!r}, expected one of {', '.join(ROLES)}"
            )
        if self.scan is not None:
            low, high = self.scan
            object.__setattr__(self, "scan", (float(low), float(high)))
            if not self.lower <= low <= high <= self.upper:
                raise ValueError(
                    f"parameter {self.name}: scan is {low} to {high}, expected it between {self.lower} and "
                    f"{self.upper}"
                )
        if self.role == "level" and not self.lower > 0.0:
            raise ValueError(f"parameter {self.name}: lower is {self.lower}, expected a level's above zero")

    @property
    def range(self) -> tuple[float, float]:
        """Where it is tried: as it says, or its usual size."""
        return self.scan or (self.scale, self.scale)


@dataclass(frozen=True)
class EffectSpec:
    """kind: "smooth", "threshold" or "measurement"; site: where it acts in the simulation, "law" for an
    elastic law, which has no numbers and stands in the place of another.

    history: numbers that it carries per point; loads_at_rest: whether it loads the object at rest as well,
    where the rest shape is an equilibrium; corrects_gravity: its three numbers add to gravity;
    carries_gravity: they are the gravity that the rest shape carries, switched on by a belief's prestress;
    simpler: the effect that it is where its flow is nothing, or as its level (a time) goes to zero;
    not_with_mls: why the MLS-MPM transfer cannot have it, empty where it can; settings: what its term needs
    besides numbers, of "place", "part" and "axis"; replaces: its null is no absence, for it takes the place
    of what the parts say; leaves_out: it is no term of a model: measurements are left out for it. Raises
    ValueError for a vector that has not three components.
    """

    name: str
    summary: str
    kind: str
    site: str
    parameters: tuple[ParameterSpec, ...] = ()
    history: int = 0
    loads_at_rest: bool = False
    corrects_gravity: bool = False
    carries_gravity: bool = False
    not_with_mls: str = ""
    settings: tuple[str, ...] = ()
    replaces: bool = False
    simpler: str = ""
    leaves_out: bool = False

    def __post_init__(self) -> None:
        for role in VECTORS:
            own = self.of_role(role)
            if len(own) not in (0, 3):
                raise ValueError(
                    f"effect {self.name}: {len(own)} numbers are of role {role}, expected x, y and z"
                )

    @property
    def fitted(self) -> tuple[ParameterSpec, ...]:
        """The parameters that a fit changes."""
        return tuple(p for p in self.parameters if p.fitted)

    @property
    def threshold(self) -> bool:
        """Whether its derivative is zero where it is absent, so that only finite values show it."""
        return self.kind == "threshold"

    @property
    def fault(self) -> bool:
        """Whether it is a fault of the measurement."""
        return self.site == "measurement"

    @property
    def in_core(self) -> bool:
        """Whether the compiled core computes it."""
        return self.site not in ("material", "law", "measurement", "user")

    @property
    def placed(self) -> bool:
        """Whether it acts at one place of the object."""
        return "place" in self.settings

    @property
    def scanned(self) -> dict[str, tuple[ParameterSpec, ...]]:
        """Its numbers that are tried over many values, by role: where it is absent no derivative tells of
        them. What `settings` names is tried as well."""
        return {role: own for role in SCANNED if (own := self.of_role(role))}

    def of_role(self, role: str) -> tuple[ParameterSpec, ...]:
        """Its parameters that play a part."""
        return tuple(p for p in self.parameters if p.role == role)
