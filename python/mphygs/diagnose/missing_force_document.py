"""The missing force of an experiment: found, read, kept in a run folder, told."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from safetensors.numpy import save

from mphygs.capture.errors import fault
from mphygs.capture.patterns import LARGEST
from mphygs.capture.tensors import read_tensors
from mphygs.diagnose.force_plugin import EFFECT, plugin_text
from mphygs.diagnose.force_readings import (
    WORDS,
    ForceSample,
    force_place,
    force_time,
    mean_direction,
    nature,
    rms,
)
from mphygs.diagnose.force_regression import Explained, formula_of
from mphygs.diagnose.missing_force import MissingForce, SequenceForce, missing_force
from mphygs.fit.experiment import Experiment
from mphygs.fit.run import same_file
from mphygs.fit.spacings import screening_spacing
from mphygs.model.belief import Belief
from mphygs.simulate.errors import SimulationError
from mphygs.simulate.fields import core_inputs
from mphygs.simulate.settings import TOTAL_LAGRANGIAN

NUMBERS, PLUGIN = "missing-force.safetensors", "missing_force.py"
FORMAT = "mphygs-force/1"
# A force that takes away less than this share of the misfit is no force: nothing is told of it.
WORTH_TELLING = 0.05


@dataclass(frozen=True, eq=False)
class Unexplained:
    """missing: the force; samples: of every sequence; explained: its formula; in_plugin: whether that may be
    written as an effect."""

    missing: MissingForce
    samples: tuple[ForceSample, ...]
    explained: Explained
    part_names: tuple[str, ...]
    in_plugin: bool = True

    def document(self) -> dict[str, object]:
        """The JSON."""
        formula = self.explained.formula
        return {
            "rms": rms(self.samples),
            "direction": [float(x) for x in mean_direction(self.samples)],
            "where": force_place(self.samples),
            "when": force_time(self.samples),
            "formula": formula.text if formula.terms else None,
            "nature": nature(self.samples),
            "terms": [
                {
                    "expression": t.expression,
                    "coefficient": t.coefficient,
                    "std": t.std,
                    "unit": t.unit,
                    "stability": t.stability,
                    "alike": list(t.alike),
                }
                for t in formula.terms
            ],
            "untold": formula.untold or None,
            "unstable": [{"expression": e, "stability": s} for e, s in formula.unstable],
            "explained": {"force": self.missing.explained, "formula": formula.explained},
            "sigma": {
                "without": float(np.sqrt(self.missing.before / self.missing.rows)),
                "with": float(np.sqrt(self.missing.after / self.missing.rows)),
            },
            "plugin": PLUGIN if self._plugin() is not None else None,
        }

    def _plugin(self) -> str | None:
        if not self.in_plugin:
            return None
        return plugin_text(self.explained.formula, self.explained.features, self.part_names)

    def save(self, folder: Path) -> None:
        """Write the force over time, and the effect in Python where the formula can be one."""
        numbers = {}
        for s in self.samples:
            numbers |= {
                f"{s.sequence}.force": s.force,
                f"{s.sequence}.position": s.position,
                f"{s.sequence}.velocity": s.velocity,
                f"{s.sequence}.frames": np.asarray(s.frames, np.int64),
                f"{s.sequence}.mass": s.mass,
                f"{s.sequence}.part": np.asarray(s.part, np.int64),
            }
        content = save({k: np.ascontiguousarray(v) for k, v in numbers.items()}, metadata={"format": FORMAT})
        part = folder / f".{NUMBERS}"
        part.write_bytes(content)
        part.replace(folder / NUMBERS)
        text = self._plugin()
        if text is not None:
            (folder / PLUGIN).write_text(text, encoding="utf-8")


def unexplained(
    experiment: Experiment,
    belief: Belief,
    spacing: float,
    *,
    seed: int,
    start: Belief | None = None,
    report: Callable[[str], None] | None = None,
) -> Unexplained | None:
    """The force that a fitted model lacks on the fitted frames, with its formula.

    start: the model fitted to the first frames, where one is known.

    On the screening grid, where the model's is finer: what is sought is coarse; by the total-Lagrangian
    transfer, whatever the model's. None where the model cannot be simulated there, or where no force explains
    what is left.
    """
    if experiment.settings.transfer != TOTAL_LAGRANGIAN:
        settings = replace(experiment.settings, transfer=TOTAL_LAGRANGIAN)
        experiment = replace(experiment, settings=settings, problems={}, observations={})
    problem = experiment.problem(max(spacing, screening_spacing(experiment.capture)))
    try:
        missing = missing_force(problem, belief, start=start, report=report)
    except SimulationError:
        return None
    if missing.explained < WORTH_TELLING:
        return None
    samples = tuple(sample_of(name, found) for name, found in missing.found.items())
    explained = formula_of(problem, missing, generator=np.random.default_rng(seed), report=report)
    names = tuple(part.name for part in experiment.capture.parts)
    return Unexplained(missing, samples, explained, names)


def with_plugin_in(
    found: Unexplained | None, folder: Path, plugin: str | Path | None
) -> Unexplained | None:
    """What was found, to be kept in a folder. plugin: of the run: where that is the file that an effect would
    be written to, none is."""
    if found is None or plugin is None or not same_file(folder / PLUGIN, plugin):
        return found
    return replace(found, in_plugin=False)


def keep_missing_force(found: Unexplained | None, folder: Path, plugin: str | Path | None = None) -> None:
    """Write what was found into a run folder, and nothing of an earlier search.

    plugin: file of effects that the run uses: it stays.
    """
    for stale in (NUMBERS, PLUGIN):
        if plugin is None or not same_file(folder / stale, plugin):
            (folder / stale).unlink(missing_ok=True)
    if found is not None:
        found.save(folder)


def sample_of(name: str, found: SequenceForce) -> ForceSample:
    """The force of one sequence at its moving frames, per mass as the parameters beside it have it."""
    seen_force, motion, basis = found.seen_force, found.motion, found.seen_force.basis
    body = seen_force.forced.predictor.body
    mass = np.bincount(basis.point_cell, core_inputs(motion.belief, body)["mass"].ravel())
    moving = motion.timeline.moving
    force = basis.over_time(found.values)[moving] * (basis.mass / mass)[:, None]
    share = basis.spread / basis.mass
    middle = [0.5 * (a[1:] + a[:-1]) for a in (motion.displacement, motion.velocity)]
    moved, velocity = (np.einsum("nc,tnd->tcd", share, a) for a in middle)
    return ForceSample(
        name, force, basis.center + moved, velocity, mass, basis.part, body.part_names, moving
    )


def load_samples(folder: Path, names: Mapping[str, object]) -> dict[str, tuple[np.ndarray, ...]]:
    """Frames (T,), positions (T, C, 3) [m] and forces (T, C, 3) [N/kg] by sequence of a run folder; empty
    where none was kept. Raises ValueError where the file is damaged."""
    path = folder / NUMBERS
    if not path.is_file():
        return {}
    expected = "a force as diagnose writes it"
    numbers = read_tensors(path, expected)
    found = {}
    for name in (name for name in names if f"{name}.force" in numbers):
        keys = [f"{name}.{what}" for what in ("frames", "position", "force")]
        missing = [key for key in keys if key not in numbers]
        if missing:
            raise fault(str(path), f"has no {missing[0]}", expected)
        frames, position, force = found[name] = tuple(numbers[key] for key in keys)
        if frames.ndim != 1 or frames.dtype != np.int64 or (frames < 0).any():
            raise fault(f"{path}: {keys[0]}", "holds what is no frame", expected)
        for key, array in zip(keys[1:], (position, force), strict=True):
            if array.ndim != 3 or array.shape != (len(frames), *position.shape[1:2], 3):
                raise fault(f"{path}: {key}", f"has shape {array.shape}", f"{expected}, (T, C, 3)")
            if array.dtype != np.float64 or not (np.abs(array) < LARGEST).all():
                raise fault(f"{path}: {key}", "holds what is no number", expected)
    return found


def missing_force_text(document: Mapping[str, object], capture: Path, folder: Path) -> list[str]:
    """Lines for people."""
    way = ", ".join(f"{x:+.2f}" for x in document["direction"])
    first, then = document["where"][0], document["when"][0]
    a, b = then["frames"]
    sigma = document["sigma"]
    lines = [
        f"missing force: {document['rms']:.3g} N/kg (rms), along ({way}); the misfit falls from "
        f"{sigma['without']:.2f} to {sigma['with']:.2f} sigma with it",
        f"  where: part {first['part']}, {first['share']:.0%} of its square, {first['rms']:.3g} N/kg there",
        f"  when: half of its square in frames {a} to {b - 1} of {then['sequence']}",
        *(f"  {WORDS[word]}" for word in document["nature"]),
    ]
    tried = ", ".join(f"{e['expression']} ({e['stability']:.0%})" for e in document["unstable"][:3])
    if document["formula"] is None:
        if document.get("untold"):
            return [*lines, f"  no formula: {document['untold']}"]
        return [*lines, f"  no stable formula{'; frames drawn again choose ' + tried if tried else ''}"]
    lines.append(f"  formula [N/kg]: {document['formula']}")
    for term in document["terms"]:
        if term["alike"]:
            lines.append(f"    {term['expression']} is not told apart from {', '.join(term['alike'])}")
    if tried:
        lines.append(f"    frames drawn again choose also {tried}")
    if document["plugin"]:
        plugin = shlex.quote(str(folder / document["plugin"]))
        lines.append(f"  add it: mphygs fit {shlex.quote(str(capture))} --plugin {plugin} --effects {EFFECT}")
    return lines
