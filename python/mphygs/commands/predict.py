"""`mphygs predict RUN`: simulate a fitted model on any sequence of the same object."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

from mphygs.baselines.kinds import maker_of
from mphygs.capture.format import Capture
from mphygs.capture.record import Sequence as Recording
from mphygs.capture.written import replace_arrays
from mphygs.commands.claim import claim_output, folder_inside
from mphygs.commands.command import Answer, run
from mphygs.commands.console import Console
from mphygs.commands.options import CommonOptions, OptionError, split_names
from mphygs.compare.image_errors import image_table, joined_errors
from mphygs.fit.object_points import predict_points
from mphygs.fit.of_run import compared_errors, experiment_of, pictured_of
from mphygs.fit.run import load_run
from mphygs.fit.tables import errors_text, parameters_of, text_table
from mphygs.scene.surface import SurfaceSamples, exposed_surface
from mphygs.simulate.prediction import Prediction

PROGRAM = "mphygs predict"
# Points of the surface that are predicted with the markers, to be looked at.
SURFACE_POINTS = 1500
PREDICTIONS = "predictions"


@dataclass(frozen=True, kw_only=True)
class PredictOptions(CommonOptions):
    """Simulate a fitted model on any sequence of the same object."""

    run: tyro.conf.Positional[Path]
    """Run folder."""
    capture: Path | None = None
    """Another capture of the same object; default: the one that was fitted."""
    sequences: Annotated[str | None, tyro.conf.arg(metavar="A,B")] = None
    """Sequences to simulate; default: all."""
    out: Path | None = None
    """Folder for the positions; default: RUN/predictions."""
    workers: int | None = None
    """Simulations side by side; default: one a core. Changes no number."""


def main(argv: Sequence[str] | None = None) -> int:
    """The command; returns its exit code."""
    return run(PredictOptions, predict_command, program=PROGRAM, argv=argv)


def predict_command(options: PredictOptions, console: Console) -> Answer:
    """Simulate every frame of the sequences; positions of markers and surface go to one .npz each."""
    state = load_run(options.run)
    parameters_of(state)  # complete, or an error
    experiment, belief = experiment_of(
        state, workers=options.workers, other=options.capture, make=maker_of(state)
    )
    recordings = _chosen(experiment.capture, split_names(options.sequences))
    if options.out is not None:
        claim_output(options.out)
    folder = options.out or folder_inside(state.folder, PREDICTIONS)
    spacing = state.settings.spacing
    surface = surface_points(experiment.capture)
    found: dict[str, dict[str, object]] = {}
    for number, recording in enumerate(recordings):
        console.progress(number / len(recordings), f"predicting {recording.name}")
        known = experiment.with_release(belief, recording.name, spacing) if recording.markers else belief
        prediction, markers = predict_points(experiment, known, recording, surface.points)
        path = folder / f"{recording.name}.npz"
        _write(path, prediction, markers, recording)
        found[recording.name] = {
            "file": str(path),
            "frames": recording.frames,
            "markers": markers,
            "substeps": prediction.substeps,
            "substep": prediction.dt,
        }
    measured = [r.name for r in recordings if r.name in experiment.compared_names()]
    compared = experiment.compare(belief, spacing, names=measured, jacobian=False) if measured else {}
    errors = compared_errors(experiment, compared)
    pictured = pictured_of(state, experiment, other=options.capture)
    drawn: dict[str, dict] = {}
    if pictured is not None:
        drawn = pictured.errors(belief, names=list(found), films=folder, report=console.say)
        errors = joined_errors(errors, drawn)
    for name, ranges in errors.items():
        found[name] |= ranges
    for name in drawn:
        found[name]["film"] = str(folder / f"{name}.mp4")
    lines = [f"{name}: {entry['frames']} frames in {entry['file']}" for name, entry in found.items()]
    lines += [f"{name}: video beside prediction in {found[name]['film']}" for name in drawn]
    if measured:
        lines += ["", errors_text({name: found[name] for name in measured})]
    if drawn:
        lines += ["", text_table(image_table({name: found[name] for name in drawn}))]
    return Answer({"run": str(state.folder), "sequences": found}, "\n".join(lines))


def _chosen(capture: Capture, wanted: Sequence[str]) -> list[Recording]:
    if not wanted:
        return list(capture.sequences)
    try:
        return [capture.sequence(name) for name in wanted]
    except KeyError as error:
        raise OptionError(f"--sequences: {error.args[0]}") from error


def surface_points(capture: Capture, count: int = SURFACE_POINTS) -> SurfaceSamples:
    """About count samples of the object's open surface."""
    corner = [part.vertices[part.faces] for part in capture.parts]
    area = sum(
        0.5 * np.linalg.norm(np.cross(t[:, 1] - t[:, 0], t[:, 2] - t[:, 0]), axis=1).sum() for t in corner
    )
    samples = exposed_surface(capture.parts, max_edge=float(np.sqrt(area / count)))
    # Meshes of many small triangles give one sample each.
    stride = slice(None, None, max(1, -(-len(samples.points) // (2 * count))))
    return SurfaceSamples(
        samples.points[stride], samples.area[stride], samples.normal[stride], samples.part[stride]
    )


def _write(path: Path, prediction: Prediction, markers: int, recording: Recording) -> None:
    """times [s], position and velocity of the markers (T, M, 3), surface (T, V, 3), in m and m/s, and what
    every instrument reads, (T, 3) a quantity."""
    arrays = {
        "times": prediction.frames / recording.fps,
        "position": prediction.position[:, :markers],
        "velocity": prediction.velocity[:, :markers],
        "surface": prediction.position[:, markers:],
    }
    for number, (sensor, reading) in enumerate(zip(recording.sensors, prediction.readings, strict=True)):
        for v, quantity in enumerate(sensor.quantities):
            arrays[f"sensor{number}_{quantity}"] = reading.value[:, v]
    replace_arrays(path, arrays)
