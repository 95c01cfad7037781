"""Gradient of a loss on one sequence's marker positions by any number of parameters, by the adjoint."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from mphygs.model.belief import Belief
from mphygs.simulate.fields import core_effects, places
from mphygs.simulate.prediction import Prediction, Predictor, Timeline, acts_in_simulation


def predict_with_gradient(
    predictor: Predictor,
    belief: Belief,
    loss_slope: Callable[[np.ndarray], np.ndarray],
    *,
    keys: Sequence[str],
    last: int,
    substep: float | None = None,
) -> tuple[Prediction, np.ndarray]:
    """The prediction of frames 0..last-1, and the gradient (K,) of a loss by the coordinates of `keys`.

    loss_slope: derivative of the loss by the marker positions, (T, M, 3) -> (T, M, 3). The cost is one
    checkpointed adjoint run, whatever the number of keys. Raises SimulationError where the run is unstable.
    """
    substep = substep or predictor.stable_substep(belief)
    simulated = [key for key in keys if acts_in_simulation(belief[key])]
    others = [key for key in keys if key not in simulated]
    prediction = predictor.predict(belief, last=last, keys=others, substep=substep)
    bar = loss_slope(prediction.position)
    gradient = dict(zip(others, np.einsum("tmc,tmck->k", bar, prediction.jacobian), strict=True))
    if simulated:
        shift_key = f"{predictor.recording.name}.release_shift"
        shift = belief[shift_key].value if shift_key in belief else 0.0
        timeline = predictor.timeline(last, substep, shift)
        times = timeline.frames / predictor.recording.fps
        bars = _before_measurement(belief, times, bar)
        slopes = _through_simulation(predictor, belief, simulated, timeline, *bars)
        gradient.update(zip(simulated, slopes, strict=True))
    return prediction, np.array([gradient[key] for key in keys])


def _before_measurement(belief: Belief, times: np.ndarray, bar: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Bars of the simulated position and velocity for the bar of what the faulty measurement shows."""
    if "length_scale" in belief.effects:
        bar = bar * (1.0 + belief["length_scale.scale"].value)
    if "frame_drift" in belief.effects:
        turn = np.array([belief[f"frame_drift.w_{a}"].value for a in "xyz"])
        bar = bar + times[:, None, None] * np.cross(bar, turn)
    velocity_bar = np.zeros_like(bar)
    if "time_offset" not in belief.effects or len(times) < 2:
        return bar, velocity_bar
    # The cubic through positions and velocities of two frames, the other way round.
    at = np.clip(times + belief["time_offset.offset"].value, times[0], times[-1])
    k = np.clip(np.searchsorted(times, at, side="right") - 1, 0, len(times) - 2)
    span = times[k + 1] - times[k]
    s = (at - times[k]) / span
    late, slope0, slope1 = 3 * s**2 - 2 * s**3, s - 2 * s**2 + s**3, s**3 - s**2
    position_bar = np.zeros_like(bar)
    for target, index, weight in (
        (position_bar, k, 1.0 - late),
        (position_bar, k + 1, late),
        (velocity_bar, k, slope0 * span),
        (velocity_bar, k + 1, slope1 * span),
    ):
        np.add.at(target, index, weight[:, None, None] * bar)
    return position_bar, velocity_bar


def _through_simulation(
    predictor: Predictor,
    belief: Belief,
    keys: Sequence[str],
    timeline: Timeline,
    position_bar: np.ndarray,
    velocity_bar: np.ndarray,
) -> list[float]:
    """Inner product of the adjoint's bars of all fields with each parameter's change of them."""
    model = predictor.model(core_effects(belief), places(belief), belief.law)
    fields = predictor.inputs(belief, timeline, model)
    hook = predictor._hook(belief, fields)
    run = (fields, timeline.schedule)
    node_bars = _onto_nodes(
        predictor,
        timeline,
        position_bar,
        velocity_bar,
        model.node_count,
        lambda: model.simulate(*run, None, hook)[0],
    )
    bars, _ = model.adjoint(*run, *node_bars, None, hook)
    slopes = []
    parameters = [belief[key] for key in keys]
    for parameter, change in zip(
        parameters, predictor.changes(belief, [(belief, p) for p in parameters]), strict=True
    ):
        total = sum(
            float(np.vdot(bars[n], np.asarray(c, float).ravel())) for n, c in change.items() if bars[n].size
        )
        if hook is not None:
            total += hook.slope(parameter, change.get("mass"))
        slopes.append(total)
    return slopes


def _onto_nodes(
    predictor: Predictor,
    timeline: Timeline,
    position_bar: np.ndarray,
    velocity_bar: np.ndarray,
    node_count: int,
    displacement_of_nodes: Callable[[], np.ndarray],
) -> tuple[np.ndarray, np.ndarray]:
    """Bars of the node displacement and velocity, (F + 1, N, 3), for those of the markers, (T, M, 3)."""
    free, node, value, gradient, turning = predictor.marker_weights()
    frames = len(timeline.schedule["steps"]) + 1
    # Before a release the markers rest; the run's own first state is then shown by no frame.
    first = 0 if predictor.recording.release is None else 1
    shown = slice(len(timeline.frames) - (frames - first), len(timeline.frames))
    bars = []
    for bar in (position_bar, velocity_bar):
        spread = np.einsum("mk,tmc->tmkc", value, bar[shown, free])
        bars.append(_scattered(spread, node, first, node_count))
    if turning.any():
        offset = predictor.attachment.offset[free][turning]
        u = np.asarray(displacement_of_nodes(), float)[first:]
        _, (left, singular, right) = predictor.rotations(u, node[turning], gradient[turning])
        rotation_bar = np.einsum("tmi,mj->tmij", position_bar[shown, free][:, turning], offset)
        # The map from dF to dR of the polar decomposition is its own adjoint.
        w = np.swapaxes(left, -1, -2) @ rotation_bar @ np.swapaxes(right, -1, -2)
        skew = (w - np.swapaxes(w, -1, -2)) / (singular[..., :, None] + singular[..., None, :])
        spread = np.einsum("tmcj,mkj->tmkc", left @ skew @ right, gradient[turning])
        bars[0] += _scattered(spread, node[turning], first, node_count)
    return bars[0], bars[1]


def _scattered(spread: np.ndarray, node: np.ndarray, first: int, node_count: int) -> np.ndarray:
    """Sums over markers of (T, M, 27, 3) at their nodes (M, 27), with `first` frames of nothing before."""
    out = np.zeros((len(spread) + first, node_count, 3))
    for t, frame in enumerate(spread):
        np.add.at(out[t + first], node.ravel(), frame.reshape(-1, 3))
    return out
