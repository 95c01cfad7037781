"""Candidate effects of a fitted model: each at its null, in the few ways it may be placed or directed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mphygs.diagnose.score_table import Score
from mphygs.diagnose.trials_of import hung_label
from mphygs.fit.start import with_effect
from mphygs.model.belief import Belief, Parameter
from mphygs.model.registry import effects
from mphygs.simulate.body import Body
from mphygs.simulate.settings import impossible_effects

# Effects that make a material differ from place to place.
GRADIENTS = tuple(name for name, spec in effects().items() if "axis" in spec.settings)
# Relaxation times [s] whose tangents are tried; the refit moves on from the best.
RELAXATION_TIMES = (0.02, 0.1, 0.5)
# Places of a point mass that the published shape bears, and of one that came later: it leans the object at
# once, which a heavier one nearer to the axis does nearly as well, and other materials.
PLACES, LATE_PLACES = 8, 48
TETHER_PLACES = 3
# A tether's stiffness is told by an estimate of so many standard deviations; else it is tried with so many
# times that at which its pull comes from as far as the object is large. Never slacker than the last [N/m].
SURE, NEARER, SLACKEST = 2.0, (1.0, 3.0), 1e-3
# Of a wind whose drag is light [m/s].
FLOW = 2.0
# Settings of a steady load that came after the published shape was taken, and how it is told from one that
# this shape bears.
LATE, SINCE_THE_START = {"at_rest": False}, ", since the first frame"


@dataclass(frozen=True, eq=False)
class Way:
    """One way in which an effect may enter: beliefs with it at its null, and parameters to differentiate by.

    effect: its name; label: unique; columns: (belief, parameter) pairs whose tangents are its columns;
    bounded: (q,) bool; values, settings: what a refit starts from besides the estimate.
    """

    effect: str
    label: str
    columns: tuple[tuple[Belief, Parameter], ...]
    bounded: np.ndarray
    settings: dict
    values: dict


def way_of(
    belief: Belief,
    name: str,
    label: str,
    wanted: Sequence[str],
    *,
    values: dict | None = None,
    settings: dict | None = None,
) -> Way:
    extended = belief.with_effect(name, values, settings) if values or settings else with_effect(belief, name)
    parameters = [extended[f"{name}.{q}"] for q in wanted]
    bounded = np.array([p.lower >= p.value for p in parameters])
    return Way(name, label, tuple((extended, p) for p in parameters), bounded, settings or {}, values or {})


def spread_places(body: Body, count: int) -> np.ndarray:
    """(count, 3) material points far from each other and from the holds, farthest first [m]."""
    points = body.quadrature.points[: body.free_block_count].mean(1)
    held = body.held_points
    distance = np.full(len(points), np.inf)
    if len(held):
        distance = np.linalg.norm(points[:, None] - held[None], axis=-1).min(1)
    chosen = []
    for _ in range(min(count, len(points))):
        chosen.append(int(distance.argmax()))
        distance = np.minimum(distance, np.linalg.norm(points - points[chosen[-1]], axis=1))
    return points[chosen]


def place_digits(body: Body) -> int:
    """Digits after the point of a length [m], millimetres at least, that tell points of two cells apart."""
    return max(3, int(np.ceil(-np.log10(0.29 * float(np.min(body.quadrature.spacing))))))


def _said(place: np.ndarray, digits: int) -> str:
    return ", ".join(f"{x:.{digits}f}" for x in place)


def mass_way(belief: Belief, place: np.ndarray, digits: int = 3, *, late: bool = False) -> Way:
    """A point mass at a place (3,) [m]; digits: of the place in the label; late: see `late_ways`."""
    settings = {"place": np.asarray(place, float).tolist()} | (LATE if late else {})
    label = f"attached_mass at ({_said(place, digits)}){SINCE_THE_START if late else ''}"
    return way_of(belief, "attached_mass", label, ["m"], settings=settings)


def wind_way(belief: Belief, direction: np.ndarray, *, late: bool = False) -> Way:
    """A flow in a direction, (3,) of length 1; late: see `late_ways`.

    Near w = 0 a drag coefficient has no derivative: a light one in a fast flow stands for it.
    """
    axis = int(np.abs(direction).argmax())
    said = ", ".join(f"{x:.2f}" for x in direction)
    if np.count_nonzero(direction) == 1:
        said = f"{'+' if direction[axis] > 0.0 else '-'}{'xyz'[axis]}"
    flow = {f"w_{a}": float(FLOW * x) for a, x in zip("xyz", direction, strict=True)}
    label = f"wind towards {said}{SINCE_THE_START if late else ''}"
    return way_of(belief, "wind", label, ["c_d"], values=flow, settings=LATE if late else None)


def _wind_ways(belief: Belief, *, late: bool = False) -> list[Way]:
    """Flows along the axes, either way."""
    axes = [sign * axis for axis in np.eye(3) for sign in (1.0, -1.0)]
    return [wind_way(belief, axis, late=late) for axis in axes]


def _tether_ways(belief: Belief, body: Body, *, late: bool = False) -> list[Way]:
    """Springs from material points, each to four anchors: these span all springs to any one anchor."""
    size, ways = float(np.ptp(body.quadrature.points.reshape(-1, 3), axis=0).max()), []
    for place in spread_places(body, TETHER_PLACES):
        settings = {"place": place.tolist()} | (LATE if late else {})
        columns = []
        for step in (np.zeros(3), *np.eye(3)):
            anchor = dict(
                zip(("anchor_x", "anchor_y", "anchor_z"), map(float, place + size * step), strict=True)
            )
            columns += way_of(belief, "tether", "", ["k"], values=anchor, settings=settings).columns
        said = _said(place, place_digits(body))
        ways.append(
            Way(
                "tether",
                f"tether at ({said}){SINCE_THE_START if late else ''}",
                tuple(columns),
                np.zeros(4, bool),
                settings | {"size": size},
                {},
            )
        )
    return ways


def late_ways(belief: Belief, body: Body, *, names: Sequence[str] | None = None) -> list[Way]:
    """Steady loads that the model lacks and that came after the published shape was taken: gravity, a wind,
    point masses, tethers. They act from the first frame on, and the shape at rest does not bear them; none
    where that shape bears nothing at all, which makes no difference then."""
    if belief.prestress != "equilibrium":
        return []
    wanted = set(effects() if names is None else names) - set(belief.effects)
    wanted -= set(impossible_effects(body.transfer))
    ways: list[Way] = []
    if "gravity" in wanted:
        label = f"gravity{SINCE_THE_START}"
        ways.append(way_of(belief, "gravity", label, [f"delta_g_{a}" for a in "xyz"], settings=LATE))
    if "wind" in wanted:
        ways += _wind_ways(belief, late=True)
    if "attached_mass" in wanted:
        places, digits = spread_places(body, LATE_PLACES), place_digits(body)
        ways += [mass_way(belief, place, digits, late=True) for place in places]
    if "tether" in wanted:
        ways += _tether_ways(belief, body, late=True)
    return ways


def principal_axis(points: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """(3,) direction of the largest spread of weighted points."""
    return _principal_axes(points, weights)[:, -1]


def _principal_axes(points: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """(3, 3) principal axes as columns, that of the largest spread last."""
    centred = points - np.average(points, axis=0, weights=weights)
    return np.linalg.eigh(np.einsum("n,ni,nj->ij", weights, centred, centred))[1]


def part_axes(body: Body, number: int) -> list[list[float]]:
    """(3, 3) principal axes of a part, as columns."""
    own = body.quadrature.part == number
    points, volumes = body.quadrature.points[own], body.quadrature.volumes[own]
    return _principal_axes(points.reshape(-1, 3), volumes.ravel()).tolist()


def smooth_ways(
    belief: Belief,
    body: Body,
    *,
    names: Sequence[str] | None = None,
    hung: Sequence[dict[str, object]] = (),
) -> list[Way]:
    """All ways of all smooth effects and faults that the model lacks and the body's transfer can have.

    hung: settings of point masses that known loads may be the weight of.
    """
    wanted = set(effects() if names is None else names) - set(belief.effects)
    wanted -= set(impossible_effects(body.transfer))
    ways: list[Way] = []
    digits = place_digits(body)

    def add(name: str, label: str, parameters: Sequence[str], **constants: dict) -> None:
        ways.append(way_of(belief, name, label, parameters, **constants))

    if "gravity" in wanted:
        add("gravity", "gravity", [f"delta_g_{a}" for a in "xyz"])
    for name, parameter in (
        ("viscosity", "eta"),
        ("mass_damping", "alpha"),
        ("air_drag", "c_d"),
        ("stiffening", "c_2"),
        ("eigenstrain", "rate"),
        ("hold_compliance", "compliance"),
    ):
        if name in wanted and (name != "hold_compliance" or body.geometry.get("hold_count")):
            add(name, name, [parameter])
    if "compressibility" in wanted:
        add("compressibility", "compressibility", ["nu"])
    if "relaxation" in wanted:
        for tau in RELAXATION_TIMES:
            add("relaxation", f"relaxation, tau {tau} s", ["ratio"], values={"tau": tau})
    if "fibre" in wanted:
        q = body.quadrature
        axes = {a: np.eye(3)[k] for k, a in enumerate("xyz")}
        main = principal_axis(q.points.reshape(-1, 3), q.volumes.ravel())
        if np.abs(main).max() < 0.97:
            axes["the principal axis"] = main
        for label, axis in axes.items():
            direction = dict(zip(("a_x", "a_y", "a_z"), map(float, axis), strict=True))
            add("fibre", f"fibre along {label}", ["k_f"], values=direction)
    if "wind" in wanted:
        ways += _wind_ways(belief)
    if "attached_mass" in wanted:
        ways += [mass_way(belief, place, digits) for place in spread_places(body, PLACES)]
        for settings in hung:
            add("attached_mass", hung_label(settings), ["m"], settings=settings)
    if "tether" in wanted:
        ways += _tether_ways(belief, body)
    for name in GRADIENTS:
        if name in wanted:
            for number, part in enumerate(body.part_names):
                columns = []
                for k in range(3):
                    settings = {"part": part, "axis": np.eye(3)[k].tolist()}
                    columns += way_of(belief, name, "", ["slope"], settings=settings).columns
                settings = {"part": part, "axes": part_axes(body, number)}
                ways.append(Way(name, f"{name} of {part}", tuple(columns), np.zeros(3, bool), settings, {}))
    for name in ("time_offset", "length_scale", "frame_drift"):
        if name in wanted:
            ways.append(way_of(belief, name, name, [p.name for p in effects()[name].fitted]))
    for name, spec in effects().items():
        if name in wanted and spec.site == "user":
            add(name, name, [p.name for p in spec.fitted])
    return ways


def base_motion_ways(belief: Belief, frequencies: Sequence[float]) -> list[Way]:
    """Harmonic motions of the frame: three axes, sine and cosine, at given frequencies [Hz]."""
    if "base_motion" in belief.effects:
        return []
    ways = []
    for f in frequencies:
        columns = []
        for phase in (0.0, float(np.pi / 2)):
            columns += way_of(
                belief, "base_motion", "", ["a_x", "a_y", "a_z"], values={"f": float(f), "phase": phase}
            ).columns
        ways.append(
            Way(
                "base_motion",
                f"base_motion at {f:.3g} Hz",
                tuple(columns),
                np.zeros(6, bool),
                {},
                {"f": float(f)},
            )
        )
    return ways


def other_starts(way: Way, score: Score, belief: Belief) -> tuple[Belief, ...]:
    """Further beliefs for a refit to start from: a gradient along each principal axis of its part alone; a
    tether that pulls as hard from nearer by, where the estimate does not tell how stiff it is.

    Across a thin part a slope of any size changes little but the linear prediction, and may lead it astray.
    """
    if way.effect == "tether":
        of_total = float(np.linalg.pinv(score.information, hermitian=True).sum())  # its variance
        if score.estimate.sum() > SURE * np.sqrt(max(of_total, 0.0)):
            return ()
        afar = float(np.linalg.norm(score.estimate[1:]))
        first = _stiffness(score.estimate)
        return tuple(_with_tether(way, k * afar, score.estimate, belief) for k in NEARER if k * afar != first)
    if way.effect not in GRADIENTS:
        return ()
    starts = []
    for axis in np.asarray(way.settings["axes"]).T:
        known = float(axis @ score.information @ axis)
        if known > 0.0:
            starts.append(_with_gradient(way, float(axis @ score.score) / known * axis, belief))
    return tuple(starts)


def _stiffness(estimate: np.ndarray) -> float:
    """Of all springs of a tether together [N/m]; where none came out, with the anchor of their pull as
    far away as the object is large."""
    total = float(estimate.sum())
    return total if total > 0.0 else float(np.linalg.norm(estimate[1:]))


def _with_tether(way: Way, stiffness: float, estimate: np.ndarray, belief: Belief) -> Belief:
    """A tether of a stiffness [N/m] that pulls, where the object was published, as the springs of an estimate
    do: of k_j to anchors p + L e_j."""
    place, size = np.array(way.settings["place"]), way.settings["size"]
    stiffness = max(stiffness, SLACKEST)
    anchor = np.clip(place + size * estimate[1:] / stiffness, place - 10 * size, place + 10 * size)
    values = {f"anchor_{a}": float(x) for a, x in zip("xyz", anchor, strict=True)}
    settings = {key: value for key, value in way.settings.items() if key != "size"}
    extended = belief.with_effect("tether", {"k": stiffness, **values}, settings)
    for a in "xyz":
        extended = extended.with_parameter(f"tether.anchor_{a}", free=True, scale=size)
    return extended


def _with_gradient(way: Way, slope: np.ndarray, belief: Belief) -> Belief:
    """slope: (3,) of the logarithm [1/m]; its length at most as the registry allows."""
    length = float(np.linalg.norm(slope))
    axis = slope / length if length > 0 else np.eye(3)[0]
    length = min(length, effects()[way.effect].parameters[0].upper)
    settings = {"part": way.settings["part"], "axis": axis.tolist()}
    return belief.with_effect(way.effect, {"slope": length}, settings)


def starting_effect(way: Way, estimate: np.ndarray, belief: Belief) -> Belief:
    """The belief with a way's effect at the score's estimate, ready for a refit."""
    name = way.effect
    if name == "tether":
        return _with_tether(way, _stiffness(estimate), estimate, belief)
    if name in GRADIENTS:
        return _with_gradient(way, estimate, belief)
    if name == "base_motion" and not way.values.get("pulse"):
        sine, cosine = estimate[:3], estimate[3:]
        # One phase for all axes: that of the largest amplitude.
        amplitude = np.hypot(sine, cosine)
        k = int(amplitude.argmax())
        phase = float(np.arctan2(cosine[k], sine[k]))
        a = sine * np.cos(phase) + cosine * np.sin(phase)
        a = np.clip(a, effects()[name].parameters[0].lower, effects()[name].parameters[0].upper)
        values = {
            **dict(zip(("a_x", "a_y", "a_z"), map(float, a), strict=True)),
            **way.values,
            "phase": phase,
        }
        return belief.with_effect(name, values)
    extended, first = way.columns[0]
    names = [p.key.rsplit(".", 1)[1] for _, p in way.columns]
    values = {p.key.rsplit(".", 1)[1]: p.value for p in extended.parameters if p.key.startswith(f"{name}.")}
    for quantity, value in zip(names, estimate, strict=True):
        spec = extended[f"{name}.{quantity}"]
        values[quantity] = float(np.clip(value, spec.lower, spec.upper))
    result = belief.with_effect(name, values, way.settings)
    if name == "wind":
        for a in "xyz":
            result = result.with_parameter(f"wind.w_{a}", prior_std=5.0)
        result = result.with_parameter("wind.c_d", prior_mean=1.0, prior_std=1.0)
    return result
