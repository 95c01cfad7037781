"""What the grid gets wrong of a fitted motion: neither to be called physics, nor to hide physics."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mphygs.compare.allowance import Allowance, modulated_directions
from mphygs.compare.grid_share import MODULATIONS
from mphygs.compare.sensor_residuals import SensorObservation, sensor_blocks
from mphygs.fit.experiment import Experiment
from mphygs.fit.problem import Evaluation
from mphygs.model.belief import Belief
from mphygs.simulate.errors import SimulationError
from mphygs.simulate.instruments import Reading

# A grid so many times as fine, or as coarse, shows the discretisation's error.
BESIDE = 1.5
# Number of the first instrument where parts are counted.
SENSORS = 500


def _of_sequence(
    experiment: Experiment, spacing: float, belief: Belief, position: np.ndarray, name: str, last: int
) -> tuple[np.ndarray, tuple[Reading, ...]] | None:
    """(T, M, 3) what a grid's prediction lacks [m], and what its readings lack, by Richardson's extrapolation
    from a finer one; from a coarser one where that cannot carry what was fitted here: thin parts that the
    grid makes too stiff are found too soft. None where neither can."""
    for ratio in (1.0 / BESIDE, BESIDE):
        try:
            other = experiment.predictor(name, spacing * ratio).predict(belief, last=last)
            here = experiment.predictor(name, spacing).predict(belief, last=last) if other.readings else other
        except SimulationError:
            continue
        whole = 1.0 - ratio**2
        lacking = tuple(
            Reading((a.value - b.value) / whole, b.jacobian)
            for a, b in zip(other.readings, here.readings, strict=True)
        )
        return (other.position - position) / whole, lacking
    return None


def _readings(
    sensors: Sequence[SensorObservation], lacking: Sequence[Reading], first: int, last: int
) -> np.ndarray:
    """(N,) what readings lack, in the rows of a fit."""
    return np.concatenate(
        [s.whitener(first, last).whiten(r.value[first:last]) for s, r in zip(sensors, lacking, strict=True)]
    )


def _whitened(
    experiment: Experiment, spacing: float, belief: Belief, evaluation: Evaluation, share: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """(N,) the error in the rows of a fit, each row's part and frame; None where none can be had."""
    problem = experiment.window(spacing, share)
    pieces, parts, frames, of_sensors = [], [], [], []
    for number, (name, (first, last)) in enumerate(problem.ranges.items()):
        error = _of_sequence(experiment, spacing, belief, evaluation.positions[name], name, last)
        if error is None:
            return None
        whitener = experiment.observations[name].whitener(first, last)
        pieces.append(whitener.whiten(error[0][first:last]))
        parts.append(problem.predictors[name].attachment.part[whitener.marker] + 1000 * number)
        frames.append(whitener.frame)
        if sensors := experiment.observations[name].sensors:
            index, frame = sensor_blocks(sensors, first, last)
            lacking = _readings(sensors, error[1], first, last)
            of_sensors.append((lacking, SENSORS + index + 1000 * number, frame))
    for piece, part, frame in of_sensors:
        pieces.append(piece)
        parts.append(part)
        frames.append(frame)
    return np.concatenate(pieces), np.concatenate(parts), np.concatenate(frames)


def allowance_of(
    experiment: Experiment, spacing: float, belief: Belief, evaluation: Evaluation, *, share: float = 1.0
) -> Allowance:
    """The discretisation's error over the first `share` of the fitted frames, as nuisance directions."""
    known = _whitened(experiment, spacing, belief, evaluation, share)
    if known is None:
        return Allowance()
    directions = modulated_directions(*known, count=MODULATIONS)
    return Allowance(directions=directions[:, np.linalg.norm(directions, axis=0) > 1e-9])


def unabsorbed(
    experiment: Experiment, spacing: float, belief: Belief, evaluation: Evaluation, *, share: float = 1.0
) -> float:
    """Root mean square [sigma] of the discretisation's error over the first `share` of the frames, less
    what the fitted parameters take up of it; infinite where no other grid can carry the model.

    evaluation: of the fit there, with Jacobian.
    """
    known = _whitened(experiment, spacing, belief, evaluation, share)
    if known is None:
        return np.inf
    error = known[0]
    basis = np.linalg.qr(evaluation.jacobian[: evaluation.data_rows])[0]
    left = error - basis @ (basis.T @ error)
    return float(np.sqrt(left @ left / max(len(left), 1)))


def may_have_all(
    experiment: Experiment, spacing: float, belief: Belief, evaluation: Evaluation
) -> bool:
    """Whether the grid may have of its own all that a fit leaves of the fitted frames beyond noise: its error
    there, less what the materials take up, is as large. evaluation: of the fit, with Jacobian."""
    return unabsorbed(experiment, spacing, belief, evaluation) ** 2 > evaluation.misfit**2 - 1.0
