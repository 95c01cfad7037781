"""A run's capture, simulators and errors, made again from its folder."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from mphygs.capture.format import Capture, load_capture
from mphygs.compare.assess import Compared
from mphygs.compare.metrics import sequence_errors
from mphygs.fit.experiment import Experiment
from mphygs.fit.image_capture import as_one_part, assembled_capture
from mphygs.fit.marker_label_repair import well_labelled
from mphygs.fit.run import DOCUMENT, Run, capture_digest
from mphygs.fit.spacings import check_spacing
from mphygs.fit.start import starting_belief
from mphygs.model.belief import Belief
from mphygs.simulate.measured_start import of_sequence
from mphygs.simulate.prediction import Maker, Predictor

if TYPE_CHECKING:
    from mphygs.fit.pictured import Pictured

# The baseline that the simulator predicts.
HOMOGENEOUS = "homogeneous"


def capture_of(run: Run) -> Capture:
    """The capture that a run was fitted to. Raises ValueError when it is no longer what was fitted."""
    capture = _as_fitted(well_labelled(load_capture(run.capture)), run)
    if capture_digest(capture) != run.digest:
        raise ValueError(
            f"{run.capture}: has changed since {run.folder} was fitted; expected the same capture"
        )
    _check_places(run, capture)
    return capture


def baseline_of(run: Run) -> str | None:
    """The baseline that a run is, by name; None for a fit of the model."""
    name = run.options.get("baseline")
    # as runs before that option said it
    return HOMOGENEOUS if run.options.get("homogeneous") else None if name is None else str(name)


def _as_fitted(capture: Capture, run: Run, *, tracked: bool = True) -> Capture:
    """A capture with what the stages of a run found of the object, where the run has stages, and with the
    parts that the run has."""
    if run.stages is not None:
        capture = assembled_capture(capture, run.stages, tracked=tracked)
    return as_one_part(capture) if baseline_of(run) == HOMOGENEOUS else capture


def pictured_of(run: Run, experiment: Experiment, *, other: Path | None = None) -> Pictured | None:
    """What it takes to draw a run's predictions; None for a capture without pictures of the object."""
    if run.stages is None:
        return None
    # torch takes seconds to import
    from mphygs.fit.pictured import Pictured

    return Pictured.of(experiment, load_capture(run.capture if other is None else other), run.stages)


def experiment_of(
    run: Run, *, workers: int | None = None, other: Path | None = None, make: Maker | None = None
) -> tuple[Experiment, Belief]:
    """Simulators of a run's capture, or of another of the same object, and the belief for them.

    make: what makes the predictors, None for simulators and nothing else.

    Nothing of another capture counts as fitted; its releases and starts enter the belief as stated or
    measured.
    Raises ValueError where the other capture has other parts or the run is a baseline that needs a make,
    CaptureError where one cannot be read.
    """
    if make is None and (name := baseline_of(run)) not in (None, HOMOGENEOUS):
        raise ValueError(f"{run.folder}: is the baseline '{name}'; expected a fit of the model")
    make = make or Predictor
    settings = run.settings if workers is None else replace(run.settings, workers=workers)
    where = f"{run.folder / DOCUMENT}: settings.spacing"
    if other is None:
        own = capture_of(run)
        check_spacing(own, settings.spacing, where)
        experiment = Experiment(own, settings, dict(run.ranges), reference=run.belief, make=make)
        for name, left_out in run.left_out.items():
            _leave_out(experiment, name, np.array(left_out))
        return experiment, run.belief
    # Tracks of another capture are not among this run's stages.
    capture = _as_fitted(well_labelled(load_capture(other)), run, tracked=False)
    check_spacing(capture, settings.spacing, where)
    parts = tuple(part.name for part in capture.parts)
    if parts != run.belief.parts:
        expected = ", ".join(run.belief.parts)
        raise ValueError(
            f"{other}: has the parts {', '.join(parts) or 'none'}; expected those of {run.folder}: {expected}"
        )
    fresh = [p for p in starting_belief(capture).parameters if of_sequence(p) is not None]
    kept = [p for p in run.belief.parameters if of_sequence(p) is None]
    belief = replace(run.belief, parameters=(*kept, *(replace(p, free=False) for p in fresh)))
    # The other capture's measured fields hold: gravity may be stated in another frame.
    belief = replace(belief, gravity=capture.gravity)
    return Experiment(capture, settings, {}, reference=belief, make=make), belief


def _check_places(run: Run, capture: Capture) -> None:
    """Parts, frames and markers of a run that its capture has. Raises ValueError."""
    recordings = {recording.name: recording for recording in capture.sequences}
    where = f"{run.folder}: damaged"
    parts = tuple(part.name for part in capture.parts)
    if run.belief.parts != parts:
        raise ValueError(f"{where}: parts {', '.join(run.belief.parts)}; expected {', '.join(parts)}")
    for name in (*run.ranges, *run.left_out):
        if name not in recordings:
            raise ValueError(f"{where}: sequence '{name}'; expected some of {', '.join(recordings)}")
    for name, (first, last) in run.ranges.items():
        count = recordings[name].frames
        if not 0 <= first < last <= count:
            raise ValueError(f"{where}: fitted frames {first}:{last} of {name}; expected some of its {count}")
    for name, entries in run.left_out.items():
        markers = recordings[name].markers
        frames, count = (0, 0) if markers is None else markers.position.shape[:2]
        for frame, marker in entries:
            if not (0 <= frame < frames and 0 <= marker < count):
                raise ValueError(
                    f"{where}: measurement ({frame}, {marker}) of {name} left out; "
                    f"expected one of {frames} frames and {count} markers"
                )


def _leave_out(experiment: Experiment, name: str, entries: np.ndarray) -> None:
    """Take single measurements out of a sequence. entries: (K, 2) frame and marker."""
    experiment.predictor(name, experiment.settings.spacing)
    observation = experiment.observations[name]
    position = observation.position.copy()
    position[entries[:, 0], entries[:, 1]] = np.nan
    experiment.observations[name] = replace(observation, position=position)


def chosen_names(experiment: Experiment, wanted: Sequence[str]) -> list[str]:
    """Sequences to compare: all that can be, or those named. Raises ValueError for one that cannot be."""
    for name in wanted:
        try:
            recording = experiment.capture.sequence(name)
        except KeyError as error:
            raise ValueError(str(error.args[0])) from error
        if recording.markers is None:
            raise ValueError(f"sequence '{name}' has no markers; expected measured points to compare with")
    found = experiment.compared_names(list(wanted) or None)
    if not found:
        raise ValueError(
            f"capture '{experiment.capture.name}': no sequence with markers and frames to fit or predict"
        )
    return found


def compared_errors(experiment: Experiment, compared: Mapping[str, Compared]) -> dict[str, dict]:
    """Errors of compared sequences, over the stated sigma where the capture states one that its tracks do not
    deny."""
    sigmas = {}
    for name, item in compared.items():
        markers = experiment.capture.sequence(name).markers
        stated = markers is not None and markers.sigma
        believed = stated and not item.observation.denied
        sigmas[name] = (
            float(np.hypot(markers.sigma, markers.offset)) if believed else item.observation.sigma
        )
    return sequence_errors(compared, sigmas)


def feedback_document(
    experiment: Experiment,
    belief: Belief,
    spacing: float,
    gain: float,
    *,
    names: Sequence[str] | None = None,
) -> dict[str, object]:
    """The errors of a model under feedback of a gain, as JSON. Raises ValueError where the transfer has
    none."""
    compared = experiment.compare(belief, spacing, names=names, jacobian=False, gain=gain)
    return {"gain": gain, "sequences": compared_errors(experiment, compared)}
