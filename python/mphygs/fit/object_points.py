"""Where any points of the object go in a sequence, markers or not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mphygs.capture.format import Markers
from mphygs.capture.record import Sequence as Recording
from mphygs.fit.experiment import Experiment
from mphygs.model.belief import Belief
from mphygs.simulate.prediction import Prediction, Predictor


def predict_points(
    experiment: Experiment, belief: Belief, recording: Recording, surface: np.ndarray
) -> tuple[Prediction, int]:
    """Every frame of a sequence, for its markers and, behind them, for points (S, 3) of the surface [m].

    Returns the prediction and the number of markers. Raises SimulationError where the run is unstable.
    """
    own = np.zeros((0, 3)) if recording.markers is None else recording.markers.at
    at = np.concatenate([own, surface])
    unmeasured = Markers(np.full((recording.frames, len(at), 3), np.nan), at, 1.0)
    body = next((p.body for p in _same_hold(experiment, recording)), None)
    settings = experiment.settings
    there = replace(recording, markers=unmeasured)
    predictor = experiment.make(experiment.capture, there, settings, body=body)
    return predictor.predict(belief), len(own)


def _same_hold(experiment: Experiment, recording: Recording) -> list[Predictor]:
    """Simulators of this very sequence that are there already."""
    problem = experiment.problems.get(experiment.settings.spacing)
    known = {} if problem is None else problem.predictors
    return [known[recording.name]] if recording.name in known else []
