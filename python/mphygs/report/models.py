"""The models that a page shows: that of the run, and the one that it grew from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from mphygs.capture.record import Sequence as Recording
from mphygs.fit.belief_document import belief_from_document
from mphygs.fit.experiment import Experiment
from mphygs.fit.object_points import predict_points
from mphygs.fit.run import Run
from mphygs.model.belief import Belief
from mphygs.report.motion_data import BUDGET, Force, markers_document, motion_document, skin_document
from mphygs.report.skin import Skin, nearest_markers
from mphygs.simulate.errors import SimulationError

# Vertices of the object, sequences that are shown, and bytes of all of them.
VERTICES, SEQUENCES, TOTAL = 2200, 8, 1_200_000


@dataclass(frozen=True, eq=False)
class ShownModel:
    """A belief on its grid [m], by a label."""

    label: str
    belief: Belief
    spacing: float


def vertices_for(sequences: int) -> int:
    """How fine the object is where so many sequences share a page."""
    return int(VERTICES * min(1.0, 3.0 / sequences))


def models_of(run: Run, belief: Belief, steps: Mapping[str, object] | None) -> tuple[ShownModel, ...]:
    """The model before anything was added, where the run is one of several steps, and the run's own."""
    own = ShownModel("after", belief, run.settings.spacing)
    told = [] if steps is None else steps["steps"]
    if len(told) < 2:
        return (replace(own, label="model"),)
    states = steps.get("states")
    if states:
        first = ShownModel("before", belief_from_document(states[0]["belief"]), float(states[0]["spacing"]))
    else:
        first = ShownModel("before", run.start, run.settings.spacing)
    return first, own


def predicted_points(
    experiment: Experiment, model: ShownModel, recording: Recording, skin: Skin
) -> np.ndarray | None:
    """(T, M + V, 3) [m] of the markers and the skin by a model; None where it cannot be simulated."""
    settings = replace(experiment.settings, spacing=model.spacing)
    there = replace(experiment, settings=settings)
    known = there.with_release(model.belief, recording.name, model.spacing)
    try:
        return predict_points(there, known, recording, skin.points)[0].position
    except SimulationError:
        return None


def motion_of(
    experiment: Experiment,
    models: tuple[ShownModel, ...],
    name: str,
    run: Run,
    skin: Skin,
    *,
    force: Force | None = None,
    budget: int = BUDGET,
) -> tuple[dict[str, object], np.ndarray]:
    """One sequence for the page, and (T, M) errors of the last model [m].

    force, budget: see `motion_document`. Raises SimulationError where the last model cannot be simulated.
    """
    recording = experiment.capture.sequence(name)
    measured = experiment.observations[name].position
    found = {}
    for model in models:
        points = predicted_points(experiment, model, recording, skin)
        if points is not None:
            found[model.label] = points
    if models[-1].label not in found:
        raise SimulationError(f"sequence '{name}': the model cannot be simulated")
    document = motion_document(
        fps=recording.fps,
        measured=measured,
        models=found,
        fit=run.ranges.get(name, (0, 0)),
        sigma=recording.markers.sigma or experiment.observations[name].sigma,
        force=force,
        budget=budget,
    )
    at, owner = recording.markers.at, experiment.predictor(name, run.settings.spacing).attachment.part
    document |= markers_document(
        *nearest_markers(skin, at, owner), recording.markers.names, marker_order(at, owner)
    )
    last = found[models[-1].label][:, : measured.shape[1]]
    return document, np.linalg.norm(measured - last, axis=2)


def marker_order(at: np.ndarray, owner: np.ndarray) -> list[int]:
    """Markers by part and along the longest axis, so that neighbours stand together. at: (M, 3) [m]."""
    axis = int(np.ptp(at, axis=0).argmax()) if len(at) else 0
    return np.lexsort((at[:, axis], owner)).tolist()


def scene_document(experiment: Experiment, skin: Skin, motions: Mapping[str, object]) -> dict[str, object]:
    """What the scene of a page is made of."""
    gravity = np.asarray(experiment.capture.gravity, float)
    size = float(np.linalg.norm(gravity))
    return {
        "up": (-gravity / size if size > 0.0 else np.array([0.0, 0.0, 1.0])).tolist(),
        "skin": skin_document(skin, [part.name for part in experiment.capture.parts]),
        "sequences": dict(motions),
    }
