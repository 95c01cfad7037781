"""What an error of the clock, the lengths, the thickness or gravity's direction does to fitted numbers.

To first order a fit moves by -(J^T J)^-1 J^T times the change of its residual (implicit function theorem):
one more prediction a line, and no refit.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from mphygs.capture.format import Capture
from mphygs.capture.meshes import Part
from mphygs.capture.record import Sequence as Recording
from mphygs.compare.noise import Observation
from mphygs.fit.levenberg_marquardt import covariance
from mphygs.fit.problem import Evaluation, Problem
from mphygs.model.belief import Belief
from mphygs.simulate.errors import SimulationError

# Relative change of rates and lengths, and angle of gravity [degree].
CHANGE, ANGLE = 0.01, 1.0
# Errors that are looked at.
KINDS = 4
# Dimensions of a part within this factor of the smallest are its section.
HARDLY_LARGER = 1.5
WHY = "E is only as good as the geometry and the clock, whatever its standard error:"


def sensitivity_of(
    problem: Problem,
    belief: Belief,
    evaluation: Evaluation,
    report: Callable[[str], None] | None = None,
) -> dict[str, dict[str, object]]:
    """By what is wrong: what it is changed by, and how far each fitted parameter would move, in its unit.

    evaluation: of the belief, at its minimum, with Jacobian. Of gravity, which may tilt either way, the
    length of both movements, without a sign. What cannot be simulated is left out. report: told each before
    it is looked at.
    """
    towards = covariance(evaluation) @ evaluation.jacobian.T
    slopes = np.array([p.slope for p in belief.free])

    def moved(changed: Problem) -> np.ndarray:
        there = replace(belief, gravity=np.asarray(changed.capture.gravity, float))
        left = changed.evaluate(there, jacobian=False).residual - evaluation.residual
        return -(towards @ left) * slopes

    found: dict[str, dict[str, object]] = {}
    for name, by, problems in _changes(problem):
        if report:
            report(f"what an error of {name} by {by} does")
        try:
            moves = np.array([moved(changed) for changed in problems])
        except (SimulationError, ValueError):
            continue
        total = moves[0] if len(moves) == 1 else np.linalg.norm(moves, axis=0)
        found[name] = {
            "change": by,
            "parameters": {p.key: float(m) for p, m in zip(belief.free, total, strict=True)},
        }
    return found


def sensitivity_lines(
    found: Mapping[str, Mapping[str, object]], parameters: Mapping[str, Mapping[str, object]]
) -> list[list[str]]:
    """Rows of a table, its head first: what moves by how much, materials in per cent."""
    keys = [key for key in parameters if any(key in entry["parameters"] for entry in found.values())]
    rows = [["an error of", *keys]]
    for name, entry in found.items():
        cells = []
        for key in keys:
            move, told = entry["parameters"].get(key, 0.0), parameters[key]
            relative = told["unit"] in ("Pa", "kg/m^3") and told["value"]
            number, unit = (100.0 * move / told["value"], "%") if relative else (move, told["unit"])
            cells.append(f"{number:.2g} {unit}" if name == "gravity" else f"{number:+.2g} {unit}")
        rows.append([f"{entry['change']} of {name}", *cells])
    return rows


def _changes(problem: Problem) -> Iterator[tuple[str, str, Sequence[Problem]]]:
    """Name, size and changed problems of every error."""
    capture, more = problem.capture, 1.0 + CHANGE
    percent = f"{100.0 * CHANGE:g} %"
    clock = replace(capture, sequences=tuple(replace(s, fps=s.fps * more) for s in capture.sequences))
    yield "clock", percent, [_of(problem, clock)]
    longer = replace(
        capture,
        parts=tuple(replace(p, vertices=p.vertices * more) for p in capture.parts),
        sequences=tuple(_longer(s, more) for s in capture.sequences),
    )
    observations = {
        name: replace(seen, position=seen.position * more) for name, seen in problem.observations.items()
    }
    # On a grid that grows with the object nothing changes but its size.
    settings = replace(problem.settings, spacing=problem.settings.spacing * more)
    yield "lengths", percent, [Problem(longer, settings, problem.ranges, observations)]
    yield (
        "thickness",
        percent,
        [_of(problem, replace(capture, parts=tuple(_thicker(p, more) for p in capture.parts)))],
    )
    down = np.asarray(capture.gravity, float)
    size = float(np.linalg.norm(down))
    if size > 0.0:
        axis = np.eye(3)[np.argmin(np.abs(down))]
        one = np.cross(down, axis) / np.linalg.norm(np.cross(down, axis))
        angle = np.radians(ANGLE)
        tilted = [
            np.cos(angle) * down + np.sin(angle) * size * side for side in (one, np.cross(down / size, one))
        ]
        yield "gravity", f"{ANGLE:g} degree", [_of(problem, replace(capture, gravity=g)) for g in tilted]


def _of(problem: Problem, capture: Capture) -> Problem:
    observations: dict[str, Observation] = dict(problem.observations)
    return Problem(capture, problem.settings, problem.ranges, observations)


def _longer(recording: Recording, factor: float) -> Recording:
    """The recording in lengths that are all larger."""
    held = tuple(
        replace(
            hold,
            box=np.asarray(hold.box) * factor,
            position=None if hold.position is None else hold.position * factor,
        )
        for hold in recording.held
    )
    loads = tuple(replace(load, box=np.asarray(load.box) * factor) for load in recording.loads)
    markers = recording.markers
    if markers is not None:
        markers = replace(markers, at=markers.at * factor, position=np.asarray(markers.position) * factor)
    sensors = tuple(s if s.at is None else replace(s, at=s.at * factor) for s in recording.sensors)
    actuators = tuple(actuator.longer(factor) for actuator in recording.actuators)
    return replace(
        recording, held=held, loads=loads, actuators=actuators, markers=markers, sensors=sensors
    )


def _thicker(part: Part, factor: float) -> Part:
    """The part larger across, about its middle: along its smallest dimension and those hardly larger."""
    vertices = part.vertices
    middle = 0.5 * (vertices.min(0) + vertices.max(0))
    _, _, axes = np.linalg.svd(vertices - vertices.mean(0))
    extents = np.ptp(vertices @ axes.T, axis=0)
    across = axes[extents < HARDLY_LARGER * extents.min()]
    return replace(part, vertices=vertices + (factor - 1.0) * (vertices - middle) @ across.T @ across)
