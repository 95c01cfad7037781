"""The cases: nulls, single effects, pairs, causes outside the list, faults, near pairs, and a trap."""

from __future__ import annotations

import fnmatch
from collections.abc import Sequence
from dataclasses import dataclass, field

from mphygs.capture.motions import HoldMovement
from mphygs.synth.marker_noise import Noise
from mphygs.synth.recipe import Recipe, Take, default_takes, recipe
from mphygs.synth.shapes import shape

# Grid of the truth over the fit's: finer, and with nodes elsewhere.
SPACING_SHARE = 0.77
# The same where finite elements compute the truth: bricks as large as the blocks of the flower.
BRICKS_SHARE = 1.2
GROUPS = ("null", "single", "pair", "outside", "fault", "near", "trap")


@dataclass(frozen=True)
class Case:
    """One case. hidden: as of `mphygs synth --hidden`; noise: its kind; fit_spacing: over a fit's default;
    simulator: what computes the truth; group_of: names that act so much alike that any may be named first
    (near, trap), beside those hidden."""

    name: str
    group: str
    kind: str = "two-part-bar"
    hidden: tuple[str, ...] = ()
    noise: str = "white"
    fit_spacing: float = 1.0
    group_of: tuple[str, ...] = field(default_factory=tuple)
    simulator: str = "total-lagrangian"

    @property
    def true_names(self) -> tuple[str, ...]:
        return tuple(text.split(":")[0] for text in self.hidden)

    def recipe(self, seed: int) -> Recipe:
        """What the capture of one seed is made of."""
        return recipe(
            self.kind,
            hidden=self.hidden,
            seed=seed,
            name=self.name,
            noise=Noise(self.noise),
            takes=_takes(self.kind),
            marker_count=300 if self.independent else 60,
            spacing_share=BRICKS_SHARE if self.independent else SPACING_SHARE,
            known="densities" if "flower" not in self.kind else "first-density",
            simulator=self.simulator,
        )

    @property
    def independent(self) -> bool:
        """Whether the truth comes from code that shares nothing with the model."""
        return self.simulator == "finite-element"


def _takes(kind: str) -> tuple[Take, ...]:
    """Short takes: one to fit and predict, another for prediction only; one of slow finite elements."""
    if "block" in kind:
        return default_takes(shape(kind), frames=64)[:1]
    if "flower" in kind:
        return default_takes(shape(kind), frames=60)
    shift = (HoldMovement("shift", 0.08, 0.33, by=(0.0, 0.018, 0.009)),)
    shake = (HoldMovement("shake", 0.08, 0.75, by=(0.0, 0.004, 0.004), frequency=4.0, ramp=0.2),)
    return (
        Take("release", shift, 60.0, 56, (0, 36), (36, 56), release=2),
        Take("shake", shake, 60.0, 50, (0, 0), (0, 50), release=2),
    )


def _elements(
    label: str, group: str, *hidden: str, kind: str = "block-flower", noise: str = "white"
) -> Case:
    """A flower whose truth comes from independent finite elements."""
    return Case(f"elements-{label}", group, kind, hidden, noise, simulator="finite-element")


def _bricks(label: str, group: str, *hidden: str) -> Case:
    """A bar of two materials whose truth comes from independent finite elements."""
    return Case(f"bricks-{label}", group, "two-part-bar", hidden, simulator="finite-element")


def _single(name: str, strengths: dict[str, str], kind: str = "two-part-bar") -> list[Case]:
    return [
        Case(f"{name}-{label}" if label else name, "single", kind, (f"{name}:{text}" if text else name,))
        for label, text in strengths.items()
    ]


CASES: tuple[Case, ...] = (
    Case("null-white", "null"),
    Case("null-correlated", "null", noise="correlated"),
    Case("null-jitter", "null", noise="jitter"),
    Case("null-coarse", "null", fit_spacing=1.4),
    Case("null-flower", "null", "flower"),
    *_single("viscosity", {"weak": "eta=15", "usual": "eta=50", "strong": "eta=120"}),
    *_single("air_drag", {"weak": "c_d=3", "usual": "c_d=10", "strong": "c_d=30"}),
    *_single("mass_damping", {"weak": "alpha=0.4", "usual": "alpha=1.5", "strong": "alpha=4"}),
    *_single("attached_mass", {"weak": "m=2e-4", "usual": "m=1.5e-3"}),
    *_single("gravity", {"weak": "delta_g_y=0.3", "usual": "delta_g_y=1:delta_g_z=0.4"}),
    *_single("stiffness_gradient", {"weak": "slope=2", "usual": "slope=9"}),
    *_single("hold_compliance", {"": ""}),
    *_single("tether", {"": ""}),
    *_single("base_motion", {"": "", "pulse": "a_y=6:f=5:phase=-9.4:pulse=1"}),
    *_single("fibre", {"": ""}),
    *_single("relaxation", {"": ""}),
    *_single("stiffening", {"": ""}),
    *_single("compressibility", {"": ""}),
    *_single("plasticity", {"": ""}),
    *_single("contact", {"": ""}),
    *_single("wind", {"": ""}),
    *_single("eigenstrain", {"": ""}),
    *_single("density_gradient", {"": ""}),
    Case("flower-air_drag", "single", "flower", ("air_drag",)),
    Case("flower-attached_mass", "single", "flower", ("attached_mass:at_rest=false",)),
    Case("pair-viscosity-mass", "pair", hidden=("viscosity:eta=50", "attached_mass:m=1e-3")),
    Case("pair-drag-tilt", "pair", hidden=("air_drag:c_d=15", "gravity:delta_g_y=1")),
    Case("pair-damping-offset", "pair", hidden=("mass_damping:alpha=2", "time_offset:offset=0.006")),
    Case("outside-cubic_drag", "outside", "flower", ("cubic_drag:c_3=40:part=head",)),
    Case("outside-point_field", "outside", hidden=("point_field:strength=0.01",)),
    Case("outside-actuation", "outside", hidden=("actuation:amplitude=2000",)),
    Case("fault-time_offset", "fault", hidden=("time_offset:offset=0.008",)),
    Case("fault-length_scale", "fault", hidden=("length_scale:scale=0.015",)),
    Case("fault-frame_drift", "fault", hidden=("frame_drift",)),
    Case("fault-marker_outliers", "fault", hidden=("marker_outliers:count=3",)),
    # A uniform bar feels a fast thin wind as it feels a tilt: a steady force in proportion to its mass.
    Case("near-tilt-or-wind", "near", "bar", ("gravity:delta_g_y=0.6",), group_of=("wind",)),
    # More mass towards the tip, as a lump or as a gradient, slows the first mode alike.
    Case(
        "near-mass-or-gradient",
        "near",
        "bar",
        ("density_gradient:slope=12",),
        group_of=("attached_mass", "stiffness_gradient"),
    ),
    # What relaxes within a hundredth of a swing is a viscosity: no motion of this bar tells the two apart.
    Case(
        "trap-viscosity-or-relaxation",
        "trap",
        hidden=("relaxation:ratio=2:tau=0.001",),
        group_of=("viscosity",),
    ),
    _elements("null", "null"),
    _elements("null-correlated", "null", noise="correlated"),
    _elements("mass_damping", "single", "mass_damping:alpha=1.2"),
    _elements("air_drag", "single", "air_drag:c_d=1.6", kind="hanging-block-flower"),
    _elements("wind", "single", "wind:w_x=1.4:w_y=0.5:c_d=1.5"),
    _elements("gravity", "single", "gravity:delta_g_x=0.7:delta_g_y=-0.4"),
    _elements("attached_mass", "single", "attached_mass:m=8e-4:place=0.04/0/0.033"),
    _elements("base_motion", "single", "base_motion:a_x=0.8:a_y=0.4:f=3.2"),
    _elements("pulse", "single", "base_motion:a_x=5:a_y=2:f=6:phase=-9:pulse=1"),
    _elements("contact", "single", "contact:n_x=-0.94:n_y=-0.34:d=-0.056:mu=0.3"),
    _elements("relaxation", "single", "relaxation:ratio=0.6:tau=0.08"),
    _elements("tether", "single", "tether:k=0.6"),
    _elements("eigenstrain", "single", "eigenstrain:rate=0.03"),
    _elements("stiffening", "single", "stiffening"),
    _elements("late-gravity", "single", "gravity:delta_g_x=0.7:delta_g_y=-0.4:at_rest=false"),
    _elements("fibre", "single", "fibre"),
    _elements("stiffness_gradient", "single", "stiffness_gradient:slope=9"),
    _elements("head-mass", "single", "attached_mass:m=2.5e-3:place=0.012/0/0.09:at_rest=false"),
    _elements("drag-tilt", "pair", "air_drag:c_d=3", "gravity:delta_g_x=0.7:delta_g_y=-0.4:at_rest=false"),
    _elements("time_offset", "fault", "time_offset:offset=0.011"),
    _elements("frame_drift", "fault", "frame_drift"),
    _elements("length_scale", "fault", "length_scale:scale=0.015"),
    _elements("cubic_drag", "outside", "cubic_drag:c_3=22:part=head"),
    _elements("actuation", "outside", "actuation:amplitude=1000:f=2.6:part=stem"),
    _elements("point_field", "outside", "point_field:strength=0.003:x=0.06:y=0.02:z=0.1"),
    _bricks("null", "null"),
    _bricks("viscosity", "single", "viscosity:eta=50"),
    _bricks("relaxation", "single", "relaxation"),
    _bricks("mass_damping", "single", "mass_damping:alpha=1.5"),
    _bricks("air_drag", "single", "air_drag:c_d=10"),
    _bricks("wind", "single", "wind"),
    _bricks("gravity", "single", "gravity:delta_g_y=1:delta_g_z=0.4"),
    _bricks("attached_mass", "single", "attached_mass:m=1.5e-3"),
    _bricks("tether", "single", "tether"),
    _bricks("base_motion", "single", "base_motion"),
    _bricks("pulse", "single", "base_motion:a_y=6:a_z=0:f=4:phase=-6:pulse=1"),
    _bricks("eigenstrain", "single", "eigenstrain"),
    _bricks("stiffening", "single", "stiffening"),
    _bricks("contact", "single", "contact"),
    _bricks("time_offset", "fault", "time_offset:offset=0.008"),
    _bricks("point_field", "outside", "point_field:strength=0.01"),
    _bricks("actuation", "outside", "actuation:amplitude=2000"),
)


def chosen(patterns: Sequence[str]) -> tuple[Case, ...]:
    """Cases whose name matches any pattern or whose group is named; all for none.

    Raises ValueError for a pattern that matches nothing.
    """
    if not patterns:
        return CASES
    found: list[Case] = []
    for pattern in patterns:
        matching = [c for c in CASES if pattern == c.group or fnmatch.fnmatch(c.name, pattern)]
        if not matching:
            raise ValueError(f"--cases: '{pattern}' matches none of {', '.join(c.name for c in CASES)}")
        found += [c for c in matching if c not in found]
    return tuple(found)
