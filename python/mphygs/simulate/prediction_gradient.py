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
    adjoint run, which is the prediction's as well, whatever the number of keys. Raises SimulationError where
    the run is unstable.
    """
    substep = substep or predictor.stable_substep(belief)
    simulated = [key for key in keys if acts_in_simulation(belief[key])]
    others = [key for key in keys if key not in simulated]

    def bars_of(found: Prediction) -> list[np.ndarray]:
        read = [reading.value for reading in found.readings]
        none = [np.zeros_like(value) for value in read]
        return [loss_slope(found.position), *(reading_slopes(read) if reading_slopes else none)]

    def through(timeline: Timeline) -> tuple[list[float], Prediction, list[np.ndarray]]:
        found, bars = (), []

        def loss(states: tuple) -> list[np.ndarray]:
            nonlocal found, bars
            found = states
            bars = bars_of(predictor.observed(belief, states, timeline, [], {}, substep, start).until(last))
            return [_longer(own, len(timeline.frames)) for own in bars]

        slopes = _through_simulation(predictor, belief, simulated, timeline, start, loss)
        wanted = [(belief, belief[key]) for key in others]
        prediction = predictor.observed(belief, found, timeline, wanted, {}, substep, start).until(last)
        return slopes, prediction, bars

    if simulated:
        predictor.stop_if_halted()
        timeline = predictor.timeline(belief, predictor.end(last), substep, start)
        (slopes, prediction, bars), _ = in_steps_that_do(timeline, through)
    else:
        prediction = predictor.predict(belief, last=last, keys=others, substep=substep, start=start)
        slopes, bars = [], bars_of(prediction)
    direct = np.einsum("tmc,tmck->k", bars[0], prediction.jacobian)
    for own, reading in zip(bars[1:], prediction.readings, strict=True):
        direct = direct + np.einsum("tvc,tvck->k", own, reading.jacobian)
    gradient = dict(zip([*simulated, *others], [*slopes, *direct], strict=True))
    return prediction, np.array([gradient[key] for key in keys])


def _through_simulation(
    predictor: Predictor,
    belief: Belief,
    keys: Sequence[str],
    timeline: Timeline,
    start: Start | None,
    loss: Callable[[tuple], Sequence[np.ndarray]],
) -> list[float]:
    """Inner product of the adjoint's bars of all fields with each parameter's change of them."""
    reading_bars: Sequence[np.ndarray] = ()

    def told(states: tuple) -> Sequence[np.ndarray]:
        nonlocal reading_bars
        position, *reading_bars = loss(states)
        return [position, *reading_bars]

    bars, _, hook = field_slopes(predictor, belief, timeline, start, told)
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
    loss: Callable[[tuple], Sequence[np.ndarray]],
) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray], UserForces | None]:
    """Gradient of a loss by every field of the core, these fields, and the hook of effects in Python.

    loss: of the states of the run, the loss's derivatives by the markers' positions as they are measured,
    (T, M, 3), and, of a loss that has them, by what each instrument reads. One run forward and one back.
    """
    transfer, carriers = predictor.transfer, predictor.carriers
    model = predictor.model_of(belief)
    fields = predictor.inputs(belief, timeline, start)
    hook = predictor._hook(belief, fields)
    transfer.share(model, predictor.workers)
    count = len(transfer.places_at_rest())

    def bars(states: tuple) -> tuple[np.ndarray | None, ...]:
        position_bar, *reading_bars = loss(states)
        seen = before_measurement(belief, timeline.frames / predictor.recording.fps, position_bar)
        carried = [*carriers.observe_adjoint(states, timeline, seen, np.zeros_like(seen), count)]
        for instrument, own in zip(predictor.instruments, reading_bars, strict=bool(reading_bars)):
            for k, part in enumerate(instrument.observe_adjoint(timeline, own, count)):
                if part is not None and k < len(carried):
                    carried[k] = carried[k] + part
                elif part is not None:
                    carried.append(part)
        return tuple(carried)

    return transfer.gradient(model, fields, predictor.schedule(timeline), bars, hook), fields, hook


def _longer(bar: np.ndarray, frames: int) -> np.ndarray:
    """Bars of so many frames, zero where there were none."""
    return np.concatenate([bar, np.zeros((frames - len(bar), *bar.shape[1:]))])
