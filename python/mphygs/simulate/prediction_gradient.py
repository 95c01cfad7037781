"""Gradient of a loss on one sequence's marker positions by any number of parameters, by the adjoint."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from mphygs.model.belief import Belief
from mphygs.simulate.measurement import before_measurement
from mphygs.simulate.prediction import Prediction, Predictor
from mphygs.simulate.scope import acts_in_simulation
from mphygs.simulate.shorter_steps import in_steps_that_do
from mphygs.simulate.timeline import Timeline
from mphygs.simulate.transfer import Start

if TYPE_CHECKING:
    from mphygs.simulate.user_forces import UserForces


def predict_with_gradient(
    predictor: Predictor,
    belief: Belief,
    loss_slope: Callable[[np.ndarray], np.ndarray],
    *,
    keys: Sequence[str],
    last: int,
    substep: float | None = None,
    start: Start | None = None,
    reading_slopes: Callable[[Sequence[np.ndarray]], Sequence[np.ndarray]] | None = None,
) -> tuple[Prediction, np.ndarray]:
    """The prediction of frames 0..last-1, and the gradient (K,) of a loss by the coordinates of `keys`.

    loss_slope: derivative of the loss by the marker positions, (T, M, 3) -> (T, M, 3); start: a state in
    mid-motion, given and not differentiated, whose frame is then the first; reading_slopes: derivatives by
    what the instruments read, (T, V, 3) each, of a loss that has them. The cost is one checkpointed
    adjoint run, whatever the number of keys. Raises SimulationError where the run is unstable.
    """
    substep = substep or predictor.stable_substep(belief)
    simulated = [key for key in keys if acts_in_simulation(belief[key])]
    others = [key for key in keys if key not in simulated]
    prediction = predictor.predict(belief, last=last, keys=others, substep=substep, start=start)
    bar = loss_slope(prediction.position)
    read = [reading.value for reading in prediction.readings]
    reading_bars = list(reading_slopes(read)) if reading_slopes else [np.zeros_like(value) for value in read]
    direct = np.einsum("tmc,tmck->k", bar, prediction.jacobian)
    for own, reading in zip(reading_bars, prediction.readings, strict=True):
        direct = direct + np.einsum("tvc,tvck->k", own, reading.jacobian)
    gradient = dict(zip(others, direct, strict=True))
    if simulated:
        # As the prediction is: instruments are told by the frames to both sides.
        end = min(last + 1, predictor.recording.frames) if predictor.instruments else last
        timeline = predictor.timeline(belief, end, substep, start)
        times = timeline.frames / predictor.recording.fps
        bar, *reading_bars = (_longer(own, len(times)) for own in (bar, *reading_bars))
        seen = before_measurement(belief, times, bar)
        slopes, _ = in_steps_that_do(
            timeline,
            lambda one: _through_simulation(predictor, belief, simulated, one, start, seen, reading_bars),
        )
        gradient.update(zip(simulated, slopes, strict=True))
    return prediction, np.array([gradient[key] for key in keys])


def _through_simulation(
    predictor: Predictor,
    belief: Belief,
    keys: Sequence[str],
    timeline: Timeline,
    start: Start | None,
    position_bar: np.ndarray,
    reading_bars: Sequence[np.ndarray],
) -> list[float]:
    """Inner product of the adjoint's bars of all fields with each parameter's change of them."""
    bars, _, hook = field_slopes(predictor, belief, timeline, start, position_bar, reading_bars)
    slopes = []
    parameters = [belief[key] for key in keys]
    changes = predictor.changes(belief, [(belief, p) for p in parameters], timeline, start)
    for parameter, change in zip(parameters, changes, strict=True):
        total = sum(
            float(np.vdot(bars[n], np.asarray(c, float).ravel())) for n, c in change.items() if bars[n].size
        )
        if hook is not None:
            total += hook.slope(parameter, change.get("mass"))
        for instrument, own in zip(predictor.instruments, reading_bars, strict=True):
            total += float(np.vdot(own, instrument.direct_slope(belief, parameter, timeline)))
        slopes.append(total)
    return slopes


def field_slopes(
    predictor: Predictor,
    belief: Belief,
    timeline: Timeline,
    start: Start | None,
    position_bar: np.ndarray,
    reading_bars: Sequence[np.ndarray] = (),
) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray], UserForces | None]:
    """Gradient of a loss by every field of the core, these fields, and the hook of effects in Python.

    position_bar: derivative of the loss by the markers' positions in the simulation, (T, M, 3); reading_bars:
    by what each instrument reads, of a loss that has them.
    """
    transfer, carriers = predictor.transfer, predictor.carriers
    model = predictor.model_of(belief)
    fields = predictor.inputs(belief, timeline, start)
    hook = predictor._hook(belief, fields)
    transfer.share(model, predictor.workers)
    run = (model, fields, predictor.schedule(timeline))
    # A marker that turns needs the motion itself: the derivative of its rotation depends on it.
    states = transfer.simulate(*run, None, hook) if carriers.turning.any() else None
    count = len(transfer.places_at_rest())
    carried = carriers.observe_adjoint(states, timeline, position_bar, np.zeros_like(position_bar), count)
    carried = [*carried]
    for instrument, own in zip(predictor.instruments, reading_bars, strict=bool(reading_bars)):
        for k, part in enumerate(instrument.observe_adjoint(timeline, own, count)):
            if part is not None and k < len(carried):
                carried[k] = carried[k] + part
            elif part is not None:
                carried.append(part)
    return transfer.adjoint(*run, tuple(carried), hook), fields, hook


def _longer(bar: np.ndarray, frames: int) -> np.ndarray:
    """Bars of so many frames, zero where there were none."""
    return np.concatenate([bar, np.zeros((frames - len(bar), *bar.shape[1:]))])
