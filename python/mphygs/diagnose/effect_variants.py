"""The ways in which effects may enter a model, as their descriptors say: places, directions, levels, flows.

No effect is known by name here: what is scanned follows from the roles of its numbers (see
`mphygs.model.descriptor`). A variant is scored by tangents at the effect's null; what does nothing there is
tried at finite values (`mphygs.diagnose.trial_scores`).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from mphygs.fit.start import starting_values
from mphygs.model.belief import Belief, Parameter
from mphygs.model.descriptor import EffectSpec, ParameterSpec
from mphygs.model.registry import effects, laws
from mphygs.simulate.body import Body
from mphygs.simulate.settings import impossible_effects

# Values of a level; places of what acts at one, and of what is tied.
LEVELS, PLACES, TIED_PLACES = 3, 8, 3
# Places of what came later: it leans the object at once, which more of it nearer to the axis does nearly as
# well, and other materials.
LATE_PLACES = 48
# Settings of a load that came after the published shape was taken, and how it is told from one that this
# shape bears.
LATE, SINCE_THE_START = {"at_rest": False}, ", since the first frame"
# Cosine from which the object's longest axis is one of x, y and z.
ALIGNED = 0.97
Values = dict[str, float]


@dataclass(frozen=True, eq=False)
class EffectVariant:
    """One way in which an effect may enter: beliefs with it at its null, and parameters to differentiate by.

    effect: its name; label: unique; columns: (belief, parameter) pairs whose tangents are its columns;
    bounded: (q,) bool; values, settings: what a refit starts from besides the estimate; form: what several
    columns of one number stand for, "axis" (of a part), "anchor", "swing" (sine and cosine), else empty;
    scale: length that belongs to it [m].
    """

    effect: str
    label: str
    columns: tuple[tuple[Belief, Parameter], ...]
    bounded: np.ndarray
    settings: dict
    values: Values
    form: str = ""
    scale: float = 0.0


def drives_body(spec: EffectSpec) -> bool:
    """Whether an effect drives all of a body that rests: a pull, a flow, a frame that swings."""
    return spec.corrects_gravity or bool(spec.of_role("flow") or spec.of_role("frequency"))


def absent_effects(belief: Belief, transfer: str, names: Sequence[str] | None) -> list[EffectSpec]:
    """The effects that a belief lacks and a transfer can have. names: to consider (None: all)."""
    impossible = impossible_effects(transfer)
    known = effects()
    wanted = known if names is None else names
    had = {*belief.effects, belief.law, *(laws() if belief.chosen_law else ())}
    return [known[n] for n in wanted if n not in had and n not in impossible]


def strengths(spec: EffectSpec) -> list[str]:
    """Names of the numbers that say how much of an effect there is."""
    return [p.name for p in spec.of_role("strength") if p.fitted]


def columns_of(
    belief: Belief,
    name: str,
    wanted: Sequence[str],
    values: Values | None = None,
    settings: dict | None = None,
) -> tuple[tuple[Belief, Parameter], ...]:
    """The effect at its null in a belief, with each of the wanted numbers to differentiate by."""
    there = belief.with_effect(name, starting_values(belief, name) | (values or {}), settings)
    return tuple((there, there[f"{name}.{q}"]) for q in wanted)


def strength_variant(
    belief: Belief, spec: EffectSpec, label: str, values: Values | None = None, settings: dict | None = None
) -> EffectVariant:
    """A variant whose columns are the effect's strengths."""
    columns = columns_of(belief, spec.name, strengths(spec), values, settings)
    bounded = np.array([p.lower >= p.value for _, p in columns])
    return EffectVariant(spec.name, label, columns, bounded, settings or {}, values or {})


def smooth_variants(
    belief: Belief, body: Body, *, names: Sequence[str] | None = None, hung: Sequence[dict] = ()
) -> list[EffectVariant]:
    """All variants of all smooth effects and faults that the model lacks and the body's transfer can have,
    but of those that swing (see `mphygs.diagnose.periodic_variants`).

    hung: settings of point masses that known loads may be the weight of.
    """
    variants: list[EffectVariant] = []
    for spec in absent_effects(belief, body.transfer, names):
        if spec.threshold or not strengths(spec) or spec.of_role("frequency"):
            continue
        if spec.site == "hold" and not body.geometry.get("hold_count"):
            continue
        variants += _variants(belief, body, spec, {})
        if spec.site == "mass":
            variants += (
                strength_variant(belief, spec, hanging_mass_label(spec, own), None, own) for own in hung
            )
    return variants


def late_variants(belief: Belief, body: Body, *, names: Sequence[str] | None = None) -> list[EffectVariant]:
    """Loads that the model lacks, which the shape at rest would bear, as ones that came after the published
    shape was taken: they act from the first frame on; none where that shape bears nothing at all, which makes
    no difference then."""
    if belief.prestress != "equilibrium":
        return []
    loads = [s for s in absent_effects(belief, body.transfer, names) if s.loads_at_rest and not s.threshold]
    return [variant for spec in loads for variant in _variants(belief, body, spec, LATE)]


def hanging_mass_label(spec: EffectSpec, settings: dict) -> str:
    """What a point mass is called that a known load is the weight of."""
    return f"{spec.name}, the load of {', '.join(settings['sequences'])}"


def _variants(belief: Belief, body: Body, spec: EffectSpec, late: dict) -> Iterator[EffectVariant]:
    suffix = SINCE_THE_START if late else ""
    if "axis" in spec.settings:
        for number, part in enumerate(body.part_names):
            yield _gradient(belief, body, spec, number, part)
        return
    for said, settings in placements(body, spec, late):
        for form, values in scanned_values(body, spec):
            label = f"{spec.name}{said}{form}{suffix}"
            if spec.of_role("anchor"):
                yield _tied(belief, body, spec, label, settings)
            else:
                yield strength_variant(belief, spec, label, values, settings)


def placements(body: Body, spec: EffectSpec, late: dict) -> Iterator[tuple[str, dict]]:
    """Where an effect is tried, in words and as settings. late: settings of what came later, or none."""
    if not spec.placed:
        yield "", dict(late)
        return
    count = TIED_PLACES if spec.of_role("anchor") else LATE_PLACES if late else PLACES
    for place in spread_places(body, count):
        yield f" at ({place_text(place, place_digits(body))})", {"place": place.tolist()} | late


def scanned_values(
    body: Body, spec: EffectSpec, *, without: Sequence[ParameterSpec] = ()
) -> Iterator[tuple[str, Values]]:
    """What is scanned of an effect besides its place: words and values. without: levels that are not."""
    choices = [
        [(f", {p.name} {v:.3g} {p.unit}", {p.name: v}) for v in level_values(p)]
        for p in spec.of_role("level")
        if p not in without
    ]
    for role, directions in (("axis", _axes), ("flow", _flows)):
        own = spec.of_role(role)
        if own:
            choices.append(
                [(text, vector_values(own, length * x)) for text, x, length in directions(body, own)]
            )
    for chosen in product(*choices):
        yield "".join(text for text, _ in chosen), {k: v for _, values in chosen for k, v in values.items()}


def level_values(parameter: ParameterSpec, count: int = LEVELS) -> list[float]:
    """Values of a level, evenly spaced in their logarithms over where it is tried."""
    low, high = parameter.range
    return [float(x) for x in np.geomspace(low, high, count if high > low else 1)]


def vector_values(parameters: Sequence[ParameterSpec], x: np.ndarray) -> Values:
    """Three numbers of an effect that are a vector's, (3,)."""
    return {p.name: float(v) for p, v in zip(parameters, x, strict=True)}


def _axes(body: Body, _parameters: Sequence[ParameterSpec]) -> Iterator[tuple[str, np.ndarray, float]]:
    for k, a in enumerate("xyz"):
        yield f" along {a}", np.eye(3)[k], 1.0
    q = body.quadrature
    main = _principal_axes(q.points.reshape(-1, 3), q.volumes.ravel())[:, -1]
    if np.abs(main).max() < ALIGNED:
        yield " along the principal axis", main, 1.0


def _flows(_body: Body, parameters: Sequence[ParameterSpec]) -> Iterator[tuple[str, np.ndarray, float]]:
    """Flows along the axes, either way. Where a flow is nothing a drag has no derivative by it: a light drag
    in a fast flow stands for it."""
    for k, a in enumerate("xyz"):
        for sign in (1.0, -1.0):
            yield f" towards {'+' if sign > 0.0 else '-'}{a}", sign * np.eye(3)[k], parameters[k].range[1]


def flow_variant(belief: Belief, spec: EffectSpec, direction: np.ndarray, settings: dict) -> EffectVariant:
    """A flow in a direction, (3,) of length 1."""
    own = spec.of_role("flow")
    label = f"{spec.name} towards {', '.join(f'{x:.2f}' for x in direction)}"
    suffix = SINCE_THE_START if settings.get("at_rest") is False else ""
    return strength_variant(
        belief, spec, label + suffix, vector_values(own, own[0].range[1] * direction), settings
    )


def placed_variant(
    belief: Belief, spec: EffectSpec, place: np.ndarray, digits: int, settings: dict
) -> EffectVariant:
    """An effect at a place (3,) [m]; digits: of the place in the label."""
    suffix = SINCE_THE_START if settings.get("at_rest") is False else ""
    label = f"{spec.name} at ({place_text(place, digits)}){suffix}"
    return strength_variant(
        belief, spec, label, None, settings | {"place": np.asarray(place, float).tolist()}
    )


def _tied(belief: Belief, body: Body, spec: EffectSpec, label: str, settings: dict) -> EffectVariant:
    """Springs from a material point, each to one of four anchors: these span all springs to any anchor."""
    size, place = extent(body), np.asarray(settings["place"])
    (strength,) = strengths(spec)
    columns: list[tuple[Belief, Parameter]] = []
    for step in (np.zeros(3), *np.eye(3)):
        anchor = vector_values(spec.of_role("anchor"), place + size * step)
        columns += columns_of(belief, spec.name, [strength], anchor, settings)
    return EffectVariant(spec.name, label, tuple(columns), np.zeros(4, bool), settings, {}, "anchor", size)


def _gradient(belief: Belief, body: Body, spec: EffectSpec, number: int, part: str) -> EffectVariant:
    """What differs from place to place in a part, along three axes."""
    columns: list[tuple[Belief, Parameter]] = []
    for axis in np.eye(3):
        columns += columns_of(belief, spec.name, strengths(spec), None, {"part": part, "axis": axis.tolist()})
    own = body.quadrature.part == number
    points, volumes = body.quadrature.points[own], body.quadrature.volumes[own]
    axes = _principal_axes(points.reshape(-1, 3), volumes.ravel()).tolist()
    settings = {"part": part, "axes": axes}
    bounded = np.zeros(len(columns), bool)
    return EffectVariant(spec.name, f"{spec.name} of {part}", tuple(columns), bounded, settings, {}, "axis")


def swing_variant(belief: Belief, spec: EffectSpec, label: str, values: Values) -> EffectVariant:
    """What swings with a frequency: its strengths times sine and cosine."""
    (phase,) = (p.name for p in spec.of_role("phase"))
    columns: list[tuple[Belief, Parameter]] = []
    for start in (0.0, float(np.pi / 2)):
        columns += columns_of(belief, spec.name, strengths(spec), values | {phase: start})
    bounded = np.zeros(len(columns), bool)
    return EffectVariant(spec.name, label, tuple(columns), bounded, {}, values, "swing")


# ---- where an object suggests to put things ------------------------------------------------------------
def spread_places(body: Body, count: int) -> np.ndarray:
    """(n, 3) material points far apart and from the holds [m], farthest first: as many as labels tell."""
    points = body.quadrature.points[: body.free_block_count].mean(1)
    held = body.held_points
    distance = np.full(len(points), np.inf)
    if len(held):
        distance = np.linalg.norm(points[:, None] - held[None], axis=-1).min(1)
    chosen: list[int] = []
    while len(chosen) < count and distance.max() > np.sqrt(3.0) * 0.1 ** place_digits(body):
        chosen.append(int(distance.argmax()))
        distance = np.minimum(distance, np.linalg.norm(points - points[chosen[-1]], axis=1))
    return points[chosen]


def extent(body: Body) -> float:
    """Largest extent of the object along an axis [m]."""
    return float(np.ptp(body.quadrature.points.reshape(-1, 3), axis=0).max())


def place_digits(body: Body) -> int:
    """Digits after the point of a length [m], millimetres at least, that tell points of two cells apart."""
    # Along what a rod or a sheet has one cell of there are no two.
    apart = [
        edge for part, cells in body.cells_of_part.items()
        for edge, several in zip(body.quadrature.spacings[part], np.ptp(cells, axis=0) > 0, strict=True)
        if several
    ]  # fmt: skip
    cell = float(min(apart, default=np.max(body.quadrature.spacings)))
    return max(3, int(np.ceil(-np.log10(0.29 * cell))))


def place_text(place: np.ndarray, digits: int) -> str:
    """A place in words."""
    return ", ".join(f"{x:.{digits}f}" for x in place)


def _principal_axes(points: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """(3, 3) principal axes as columns, that of the largest spread last."""
    centred = points - np.average(points, axis=0, weights=weights)
    return np.linalg.eigh(np.einsum("n,ni,nj->ij", weights, centred, centred))[1]
