"""Faults of the measurement: what they make of the simulated markers, forwards and back."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mphygs.model.belief import Belief, Parameter
from mphygs.model.fault import Fault
from mphygs.model.registry import faults

Owned = tuple[Belief, Parameter]


def lateness(belief: Belief) -> float:
    """How much later than stated the frames were taken [s]."""
    return sum((fault.late(values) for fault, values in _acting(belief)), 0.0)


def with_measurement_faults(
    belief: Belief,
    wanted: Sequence[Owned],
    times: np.ndarray,
    position: np.ndarray,
    velocity: np.ndarray,
    jacobian: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Faults of the measurement, applied to what the simulation says.

    A late clock has its part already: the simulation shows the frames when they were taken. Under feedback
    the columns of faults hold already what they make of the motion, by moving its targets. times: (T,) that
    the measurement states [s]; position [m], velocity [m/s]: (T, M, 3); jacobian: (T, M, 3, K) by the wanted
    parameters, whose columns of faults are filled here.
    """
    jacobian = jacobian.copy()
    keys = [parameter.key.rpartition(".")[::2] for _, parameter in wanted]
    acting = dict(_acting(belief))
    for fault in faults():
        if fault in acting:
            jacobian = fault.pushed(acting[fault], times, jacobian)
        for slot, (name, quantity) in enumerate(keys):
            if name == fault.name:
                owner, parameter = wanted[slot]
                values = acting.get(fault) or owner.values_of(name)
                slope = fault.derivative(quantity, values, times, position, velocity)
                jacobian[..., slot] += slope * parameter.slope
        if fault in acting:
            position, velocity = fault.shown(acting[fault], times, position, velocity)
    return position, velocity, jacobian


def without_measurement_faults(belief: Belief, times: np.ndarray, position: np.ndarray) -> np.ndarray:
    """Where the markers truly were, (T, M, 3) [m]: what was measured, less the belief's faults but for the
    clock."""
    for fault, values in reversed(_acting(belief)):
        position = fault.undone(values, times, position)
    return position


def before_measurement(belief: Belief, times: np.ndarray, bar: np.ndarray) -> np.ndarray:
    """Bar of the simulated positions, (T, M, 3), for the bar of what the measurement shows."""
    for fault, values in reversed(_acting(belief)):
        bar = fault.pulled(values, times, bar)
    return bar


def _acting(belief: Belief) -> list[tuple[Fault, dict[str, float]]]:
    """The belief's faults with their numbers, in the order in which they act."""
    return [(fault, belief.values_of(fault.name)) for fault in faults() if fault.name in belief.effects]
