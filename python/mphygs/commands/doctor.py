"""`mphygs doctor CAPTURE`: what can be said of a recording before any fit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

from mphygs.capture.format import Capture, load_capture
from mphygs.capture.layouts import unit_remarks
from mphygs.capture.record import Sequence as Recording
from mphygs.capture.sensors import FORCE, UNITS
from mphygs.commands.command import Answer, run
from mphygs.commands.console import Console
from mphygs.commands.options import CommonOptions, OptionError, split_names
from mphygs.compare.sensor_residuals import seen_noise
from mphygs.diagnose.next_motion import candidate_motions
from mphygs.fit.examination import Examined, examine, remarks
from mphygs.fit.experiment import Experiment
from mphygs.fit.identifiable import Expected, Identifiable, expected_document
from mphygs.fit.marker_label_repair import well_labelled
from mphygs.fit.placement import with_placed_effect
from mphygs.fit.spacings import screening_spacing
from mphygs.fit.start import starting_belief
from mphygs.fit.tables import text_table
from mphygs.model.registry import effects
from mphygs.simulate.errors import SimulationError
from mphygs.simulate.measured_start import of_sequence
from mphygs.simulate.prediction import Predictor
from mphygs.simulate.settings import Settings

PROGRAM = "mphygs doctor"
# Soft objects are seldom smaller or larger across [m]; gravity on earth, give or take [m/s^2].
USUAL_SIZE, EARTH = (0.005, 3.0), (9.7, 9.9)
# Motions that are named.
SHOWN = 3
# Times that an instrument may scatter more, or less, than stated: fast motion looks like scatter.
UNLIKE = 3.0


@dataclass(frozen=True)
class Useful:
    """A motion that could be recorded. gain: how much it shrinks what is possible of all numbers [nat];
    tells: numbers that the recorded motion does not tell, and both together do."""

    motion: str
    gain: float
    tells: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class DoctorOptions(CommonOptions):
    """Check a capture before a fit: units, rates, gaps, noise, and which numbers the motion can tell."""

    capture: tyro.conf.Positional[Path]
    """Folder of the capture."""
    effects: Annotated[str | None, tyro.conf.arg(metavar="a,b")] = None
    """Effects whose numbers are looked at beside the materials."""
    motions: bool = True
    """Simulate further motions of the hold, where a number is not told, and name those that would help."""
    workers: int | None = None
    """Simulations side by side; default: one a core. Changes no number."""


def main(argv: Sequence[str] | None = None) -> int:
    """The command; returns its exit code."""
    return run(DoctorOptions, doctor_command, program=PROGRAM, argv=argv)


def doctor_command(options: DoctorOptions, console: Console) -> Answer:
    """Look at a capture; findings are no fault: exit code 0."""
    capture = well_labelled(load_capture(options.capture))
    for name in split_names(options.effects):
        if name not in effects():
            known = ", ".join(sorted(effects()))
            raise OptionError(f"--effects: unknown effect '{name}'; expected some of {known}")
    document: dict[str, object] = {"capture": str(options.capture), "name": capture.name}
    findings = [*object_remarks(capture), *unit_remarks(capture)]
    expected, motions, examined = None, [], {}
    if capture.parts:
        settings = Settings(screening_spacing(capture))
        if options.workers is not None:
            settings = Settings(settings.spacing, workers=options.workers)
        for recording in capture.sequences:
            if recording.markers is None:
                findings.append(f"{recording.name}: has no markers; nothing of it is looked at here")
                continue
            console.say(f"looking at {recording.name}")
            examined[recording.name] = examine(
                capture, recording, Predictor(capture, recording, settings).attachment
            )
            findings += [f"{recording.name}: {finding.text}" for finding in recording.markers.findings]
            findings += remarks(recording.name, examined[recording.name])
            findings += sensor_remarks(recording)
        expected, motions, said = _expected(capture, settings, options, examined, console)
        findings += said
    document |= {
        "object": _object(capture),
        "sequences": {name: found.document() for name, found in examined.items()},
        "parameters": None if expected is None else expected_document(expected),
        "motions": [asdict(motion) for motion in motions],
        "findings": findings,
    }
    return Answer(document, _text(capture, examined, expected, motions, findings))


def object_remarks(capture: Capture) -> list[str]:
    """What of the object and its gravity is unusual, or not looked at."""
    lines = []
    if not capture.parts:
        return [
            "the object is given in pictures: its size and what its motion tells are known once mphygs "
            "reconstruct, segment and track have run; markers and meshes are looked at here"
        ]
    size = capture.diagonal or 0.0
    if not USUAL_SIZE[0] <= size <= USUAL_SIZE[1]:
        large = size > USUAL_SIZE[1]
        what = "its files are in mm" if large else "a scale was applied twice"
        factor = 1e-3 if large else 1e3
        lines.append(
            f"the object is {size:.3g} m across; if {what}, set scale to {factor:g} times its value "
            f"(then it is {1e3 * factor * size:.3g} mm)"
        )
    strength = float(np.linalg.norm(capture.gravity))
    if not EARTH[0] <= strength <= EARTH[1]:
        lines.append(f"gravity is {strength:.3g} m/s^2; on earth it is 9.81, however the object is turned")
    forces = any(sensor.kind == FORCE for sequence in capture.sequences for sensor in sequence.sensors)
    if not capture.known.density and capture.known.mass is None and not forces:
        lines.append(
            "neither mass nor density is stated: motion under gravity alone tells stiffness only relative to "
            "density; weigh the object (object.known.mass), or measure the force at its hold (sensors)"
        )
    return lines


def sensor_remarks(recording: Recording) -> list[str]:
    """Instruments whose readings scatter from frame to frame unlike their stated sigma."""
    lines = []
    for sensor in recording.sensors:
        for v, quantity in enumerate(sensor.quantities):
            stated, seen = float(sensor.sigma[v]), seen_noise(sensor.value[:, v])
            if np.isfinite(stated) and not 1.0 / UNLIKE < seen / stated < UNLIKE:
                what = sensor.label if quantity in sensor.label else f"{sensor.label}, {quantity}"
                unit = UNITS[quantity]
                lines.append(
                    f"{recording.name}: {what}: sigma is stated as {stated:.3g} {unit}, but from frame to "
                    f"frame it scatters by {seen:.3g} {unit}"
                )
    return lines


def _object(capture: Capture) -> dict[str, object]:
    volume = {part.name: part.volume for part in capture.parts}
    return {
        "size": capture.diagonal,
        "volume": volume or None,
        "gravity": np.asarray(capture.gravity, float),
        "mass": capture.known.mass,
    }


def _expected(
    capture: Capture,
    settings: Settings,
    options: DoctorOptions,
    examined: Mapping[str, Examined],
    console: Console,
) -> tuple[dict[str, Expected] | None, list[Useful], list[str]]:
    """Expected standard errors at usual values, motions that would tell more, the best first, and lines."""
    if not any(s.markers is not None and s.fit[1] > s.fit[0] for s in capture.sequences):
        return None, [], ["no sequence has markers and frames to fit; expected a range fit in one of them"]
    experiment = Experiment.of(capture, settings)
    belief = experiment.starting(starting_belief(capture))
    for name in split_names(options.effects):
        belief = with_placed_effect(belief, name, capture, tuple(experiment.fitted))
    console.say("looking at what the motion tells, at usual values")
    try:
        known = Identifiable.of(experiment, belief)
    except SimulationError as error:
        return None, [], [f"what the motion tells is not known: at usual values {error}"]
    expected = known.expected()
    own = {p.key for p in known.belief.free if of_sequence(p) is not None}
    poor = [key for key, entry in expected.items() if not entry.determined and key not in own]
    lines = [f"{key} is not told by this motion: {expected[key].note}" for key in poor]
    if not poor or not options.motions:
        return expected, [], lines
    first = next(iter(experiment.fitted))
    recording, found = capture.sequence(first), []
    frequency = examined[first].frequency or 1.0 / examined[first].seconds
    proposed = candidate_motions(capture, recording, frequency)
    for number, (text, motion) in enumerate(proposed.items()):
        console.progress(number / len(proposed), text)
        try:
            more = known.of_motion(experiment, motion, examined[first].sigma_stated)
        except SimulationError:
            continue
        if more is not None:
            then = known.expected(more)
            found.append(Useful(text, known.gain(more), tuple(k for k in poor if then[k].determined)))
    if found and not any(motion.tells for motion in found):
        lines.append(
            f"none of {len(found)} ways to shake or rock the hold would tell {', '.join(poor)}: "
            "measure one of them on its own"
        )
    return expected, sorted(found, key=lambda m: (-len(m.tells), -m.gain)), lines


def _text(
    capture: Capture,
    examined: Mapping[str, Examined],
    expected: Mapping[str, Expected] | None,
    motions: Sequence[Useful],
    findings: Sequence[str],
) -> str:
    size = "" if capture.diagonal is None else f", {1e3 * capture.diagonal:.4g} mm across"
    count = len(capture.parts)
    lines = [f"{capture.name}: {count} part{'' if count == 1 else 's'}{size}", ""]
    head = "sequence fps frames markers missing sigma seen moves begins"
    rows = [head.split(), ["", "1/s", "", "", "%", "mm", "mm", "Hz", ""]]
    for name, e in examined.items():
        seen = "-" if e.sigma_seen is None else f"{1e3 * e.sigma_seen:.3g}"
        rows.append(
            [name, f"{e.fps:g}", str(e.frames), str(e.markers), f"{100 * e.missing:.1f}",
             f"{1e3 * e.sigma_stated:.3g}", seen, f"{e.frequency:.3g}",
             "at rest" if e.begins == "rest" else "in motion"]
        )  # fmt: skip
    if examined:
        lines += [text_table(rows), ""]
    if expected:
        rows = [["expected at usual values", "value", "std", "unit", ""]]
        rows += [
            [key, f"{e.value:.4g}", f"{e.std:.2g}", e.unit, "" if e.determined else "NOT TOLD"]
            for key, e in expected.items()
        ]
        lines += [text_table(rows), ""]
    lines += [f"- {line}" for line in findings] or ["nothing found that would stand in the way of a fit"]
    told = [motion for motion in motions if motion.tells][:SHOWN]
    if told:
        lines += ["", "recordings that would tell more:"]
        lines += [f"  {motion.motion}: {', '.join(motion.tells)}" for motion in told]
    return "\n".join(lines)
