"""How a capture with known truth is made: object, materials, motions, what is hidden, noise."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from mphygs.capture.motions import HoldMovement
from mphygs.simulate.settings import TRANSFERS
from mphygs.synth.drive import Drive
from mphygs.synth.hidden import Hidden, parse
from mphygs.synth.marker_noise import Noise
from mphygs.synth.shape import Shape
from mphygs.synth.shapes import shape
from mphygs.synth.synthetic_sensors import parse_sensors

SIMULATORS = (*TRANSFERS, "finite-element", "rod", "shell")
KNOWN = ("first-density", "densities", "mass", "none")


@dataclass(frozen=True)
class Material:
    """Young's modulus [Pa], density [kg/m^3] of the published shape, Poisson's ratio [-]."""

    youngs_modulus: float
    density: float
    poissons_ratio: float


@dataclass(frozen=True)
class Take:
    """One recorded motion. fit, predict: frame ranges; release: all points rest until this frame; cut: frames
    of the motion before frame 0, which the capture does not show, the release among them; pull: (3,) force
    [N] that grows over these on what is about the tip, and is gone with frame 0; drive: a load of the object
    that the capture states; far_motions: of a second hold."""

    name: str
    motions: tuple[HoldMovement, ...]
    fps: float
    frames: int
    fit: tuple[int, int]
    predict: tuple[int, int]
    release: int | None = None
    cut: int = 0
    pull: tuple[float, float, float] | None = None
    drive: Drive | None = None
    far_motions: tuple[HoldMovement, ...] = ()


# How a motion begins: from rest, let go where it was pulled aside, or in the midst of a movement of its hold.
STARTS = ("rest", "pulled", "moving")
# Force that pulls an object aside, in its usual weight, and for how long it grows [s].
PULL, PULLED = 0.3, 1.0
# Share of a movement of the hold that is over where a film begins in its midst.
MIDST = 0.6
# Cells of the grid whose spacing the truth's is stated in.
TRUTH_CELLS = 250


def truth_spacing(share: float, volume: float) -> float:
    """Spacing of the truth's grid [m]: a share of that at which an object is worth TRUTH_CELLS cells.

    volume: of the object [m^3].
    """
    return share * float(np.cbrt(volume / TRUTH_CELLS))


@dataclass(frozen=True, eq=False)
class Recipe:
    """Everything a capture is made of; the same recipe gives the same files.

    spacing_share: of the spacing at which the object is worth TRUTH_CELLS cells, at which the truth is
    simulated (see `truth_spacing`); known: what the capture states beside Poisson's ratio, the density of the
    first part, of all parts, or the mass of the object; sensors: kind -> standard deviation, see
    `mphygs.synth.synthetic_sensors`.
    simulator: a transfer of the core, "total-lagrangian" or "mls", or "finite-element" for code that shares
    nothing with the model fitted and takes objects of boxes; its bricks are at most twice the spacing, having
    three nodes each way; "rod" for cables and "shell" for strips, which share nothing with it either.
    """

    name: str
    shape: Shape
    materials: Mapping[str, Material]
    takes: tuple[Take, ...]
    hidden: tuple[Hidden, ...] = ()
    noise: Noise = field(default_factory=Noise)
    marker_count: int = 120
    seed: int = 0
    spacing_share: float = 0.62
    known: str = "first-density"
    simulator: str = "total-lagrangian"
    sensors: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.simulator not in SIMULATORS:
            raise ValueError(f"simulator '{self.simulator}': expected one of {', '.join(SIMULATORS)}")
        if self.known not in KNOWN:
            raise ValueError(f"known '{self.known}': expected one of {', '.join(KNOWN)}")

    @property
    def mass(self) -> float:
        """Of the whole object [kg]."""
        return sum(self.materials[part.name].density * part.volume for part in self.shape.parts)

    def of_kind(self, kind: str) -> tuple[Hidden, ...]:
        """What is hidden of one kind: effect, fault or cause."""
        return tuple(h for h in self.hidden if h.kind == kind)


def usual_motion(kind: str, lying: bool) -> HoldMovement:
    """A movement of the hold that shakes an object well; lying: one that stretches across gravity along x.

    Raises ValueError for a kind that there is not.
    """
    table = {
        "shake": HoldMovement("shake", 0.1, 1.9, by=(0.008, 0.005, 0.0), frequency=1.7, ramp=0.25),
        "rock": HoldMovement("rock", 0.1, 1.9, axis=(0.0, 0.0, 1.0), degrees=30.0, frequency=1.0, ramp=0.25),
        "shift": HoldMovement("shift", 0.3, 1.0, by=(0.02, 0.0, 0.03)),
        "turn": HoldMovement("turn", 0.6, 1.3, axis=(0.0, 1.0, 0.0), degrees=5.0),
    }
    if lying:
        table = {
            "shake": HoldMovement("shake", 0.1, 1.2, by=(0.0, 0.005, 0.003), frequency=3.1, ramp=0.25),
            "rock": HoldMovement(
                "rock", 0.1, 1.2, axis=(0.0, 1.0, 0.2), degrees=8.0, frequency=2.2, ramp=0.25
            ),
            "shift": HoldMovement("shift", 0.1, 0.4, by=(0.0, 0.02, 0.01)),
            "turn": HoldMovement("turn", 0.3, 0.8, axis=(1.0, 0.0, 0.0), degrees=25.0),
        }
    if kind not in table:
        raise ValueError(f"motion '{kind}': expected one of {', '.join(table)}")
    return table[kind]


def default_takes(
    kind: Shape,
    *,
    frames: int = 80,
    kinds: tuple[str, ...] = (),
    start: str = "rest",
    drive: Drive | None = None,
) -> tuple[Take, ...]:
    """Two motions for an object, one to fit and one for prediction only.

    kinds: movements of the first, as of `usual_motion`; none: as suits the object; start: of both, as in
    STARTS; drive: what moves the object in place of its hold. An object that is free of stress at rest is let
    go at frame 2. Raises ValueError for others.
    """
    if start not in STARTS:
        raise ValueError(f"start '{start}': expected one of {', '.join(STARTS)}")
    if drive is not None and (start != "rest" or kinds):
        raise ValueError("drive: the hold stands still and the motion begins at rest; expected neither else")
    if kind.far_hold is not None:
        return _two_handed_takes(kind, frames=frames, kinds=kinds, start=start)
    lying = kind.rest == "stress-free"
    thin = any(part.shape != "solid" for part in kind.parts)
    fps, release = 60.0 if lying or thin else 30.0, 2 if lying else None
    first = kinds or (("shift",) if lying else ("shake", "turn"))
    second = ("shake", "turn") if lying else ("rock", "shift")
    split = round(0.625 * frames)
    takes = []
    for name, movements, fit, predict, side in (
        ("a", first, (0, split), (split, frames), 1.0),
        ("b", second, (0, 0), (0, frames), -1.0),
    ):
        moved = () if drive else tuple(usual_motion(k, lying) for k in movements)
        cut, pull = 0, None
        if start == "pulled":
            weight = 9.81 * sum(kind.density[part.name] * part.volume for part in kind.parts)
            across = np.cross(kind.axis, [0.0, 0.0, 1.0] if lying else [1.0, 0.0, 0.0])
            pull = tuple(side * PULL * weight * across)
            moved, cut = (), round(PULLED * fps)
        elif start == "moving":
            cut = round(fps * (moved[0].start + MIDST * (moved[0].stop - moved[0].start)))
        takes.append(Take(name, moved, fps, frames, fit, predict, release, cut, pull, drive))
    return tuple(takes)


def _two_handed_takes(kind: Shape, *, frames: int, kinds: tuple[str, ...], start: str) -> tuple[Take, ...]:
    """Two motions of a cable between two hands, the far one of which twists it about its end as well.

    kinds: movements of the far hand in the motion to fit, as of `two_handed_motion`.
    """
    if start == "pulled":
        raise ValueError(f"start 'pulled': not of the object '{kind.name}'; expected rest or moving")
    fps, split = 100.0, round(0.625 * frames)
    cut = round(fps * 0.35) if start == "moving" else 0
    near, far = two_handed_motion("rock"), tuple(two_handed_motion(k) for k in kinds or ("shift", "turn"))
    others = tuple(two_handed_motion(k) for k in ("shake", "rock"))
    return (
        Take("a", (two_handed_motion("shake"),), fps, frames, (0, split), (split, frames), 2, cut,
             far_motions=far),
        Take("b", (near,), fps, frames, (0, 0), (0, frames), 2, cut, far_motions=others),
    )  # fmt: skip


def two_handed_motion(kind: str) -> HoldMovement:
    """A movement of one hand at a cable's end, whose axis is along z. Raises ValueError for other kinds."""
    table = {
        "shake": HoldMovement("shake", 0.05, 1.45, by=(0.004, 0.008, 0.002), frequency=2.3, ramp=0.25),
        "rock": HoldMovement(
            "rock", 0.05, 1.45, axis=(0.0, 0.2, 1.0), degrees=60.0, frequency=1.4, ramp=0.25
        ),
        "shift": HoldMovement("shift", 0.1, 0.6, by=(-0.03, 0.025, 0.01)),
        "turn": HoldMovement("turn", 0.15, 0.75, axis=(0.0, 0.0, 1.0), degrees=100.0),
    }
    if kind not in table:
        raise ValueError(f"motion '{kind}': expected one of {', '.join(table)}")
    return table[kind]


def default_materials(
    kind: Shape, seed: int, *, poissons_ratio: float = 0.35, spread: float = 0.15
) -> dict[str, Material]:
    """Usual materials of an object's parts, moved by the seed: spread is that of the logarithms."""
    generator = np.random.default_rng([seed, 1])
    materials = {}
    for name in kind.part_names:
        stiff, dense = np.exp(spread * generator.standard_normal(2))
        materials[name] = Material(
            float(f"{kind.youngs_modulus[name] * stiff:.3g}"),
            float(f"{kind.density[name] * dense:.3g}"),
            poissons_ratio,
        )
    return materials


def recipe(
    kind: str,
    *,
    hidden: tuple[str, ...] = (),
    seed: int = 0,
    noise: Noise | None = None,
    name: str | None = None,
    frames: int = 80,
    marker_count: int = 120,
    takes: tuple[Take, ...] | None = None,
    spacing_share: float = 0.62,
    sizes: Mapping[str, float] | None = None,
    known: str = "first-density",
    simulator: str | None = None,
    sensors: tuple[str, ...] = (),
) -> Recipe:
    """A recipe from names. kind: as in shapes; hidden: each `name` or `name:key=value:...`; simulator: None
    for the object's usual one; sensors: each `kind` or `kind:sigma=value`.

    Raises ValueError for unknown kinds, names and keys, and for something hidden twice.
    """
    body = shape(kind, **(sizes or {}))
    materials = default_materials(body, seed)
    mass = sum(materials[part.name].density * part.volume for part in body.parts)
    stiffest = max(m.youngs_modulus for m in materials.values())
    things = tuple(parse(text, body, mass, stiffest) for text in hidden)
    if len({h.name for h in things}) != len(things):
        raise ValueError(f"hidden '{', '.join(hidden)}': expected every name once")
    return Recipe(
        name=name or kind,
        shape=body,
        materials=materials,
        takes=takes or default_takes(body, frames=frames),
        hidden=things,
        noise=noise or Noise(),
        marker_count=marker_count,
        seed=seed,
        spacing_share=spacing_share,
        known=known,
        simulator=simulator or body.simulator,
        sensors=parse_sensors(sensors, body, mass * float(np.linalg.norm(body.gravity))),
    )
