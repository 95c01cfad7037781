"""Faults of the measurement, put on true tracks: they change what is seen, not what moves."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from mphygs.capture.rotation import matrix_from_rotation_vector
from mphygs.model.registry import effect

# Usual values: parameter -> number, in the units of the registry.
DEFAULTS: Mapping[str, Mapping[str, float]] = {
    "time_offset": {"offset": 0.012},
    "length_scale": {"scale": 0.02},
    "frame_drift": {"v_x": 1e-3, "v_y": -5e-4, "w_z": 1e-2},
    "marker_outliers": {"count": 4},
}
# Markers that do not follow the object walk: root of their mean square change per second [m].
WALK = 0.01


def fault_values(name: str, given: Mapping[str, float]) -> dict[str, float]:
    """All parameters of a fault: those given, zero for the rest; the usual ones when none is given.

    Raises ValueError for a name that is no fault and for a parameter that it has not.
    """
    if name not in DEFAULTS:
        raise ValueError(f"fault '{name}': expected one of {', '.join(DEFAULTS)}")
    known = [p.name for p in effect(name).parameters]
    for key in given:
        if key not in known:
            raise ValueError(f"fault '{name}' has no '{key}', expected one of {', '.join(known)}")
    return {key: float((given or DEFAULTS[name]).get(key, 0.0)) for key in known}


def shifted(times: np.ndarray, position: np.ndarray, velocity: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Positions (T', M, 3) [m] at other times [s], by the cubic through positions and velocities; at the
    first position before the first time. Raises ValueError for times after the last."""
    if at.max(initial=-np.inf) > times[-1] + 1e-12:
        raise ValueError(f"the state at {at.max()} s is asked for, expected at most {times[-1]} s")
    return CubicHermiteSpline(times, position, velocity, axis=0)(np.maximum(at, times[0]))


def seen_through(
    position: np.ndarray,
    times: np.ndarray,
    faults: Mapping[str, Mapping[str, float]],
    movable: np.ndarray,
    generator: np.random.Generator,
) -> tuple[np.ndarray, np.ndarray]:
    """What a faulty measurement shows of true tracks.

    position: (T, M, 3) [m] at times (T,) [s], the time offset being in them already; movable: (M,) bool, the
    markers that may lose the object. Returns the tracks and (K,) indices of the markers that do.
    """
    outliers = np.zeros(0, dtype=int)
    if "marker_outliers" in faults:
        count = int(faults["marker_outliers"]["count"])
        candidates = np.flatnonzero(movable)
        if not 0 < count <= len(candidates):
            raise ValueError(f"marker_outliers: count {count}, expected 1 to {len(candidates)}")
        outliers = np.sort(generator.choice(candidates, count, replace=False))
        step = WALK * np.sqrt(np.diff(times, prepend=times[0]))
        walk = np.cumsum(step[:, None, None] * generator.standard_normal((len(times), count, 3)), axis=0)
        position = position.copy()
        position[:, outliers] += walk
    if "frame_drift" in faults:
        rates = faults["frame_drift"]
        velocity, turning = (np.array([rates[f"{kind}_{a}"] for a in "xyz"]) for kind in "vw")
        rotation = matrix_from_rotation_vector(times[:, None] * turning)
        position = np.einsum("tij,tmj->tmi", rotation, position) + times[:, None, None] * velocity
    if "length_scale" in faults:
        position = position * (1.0 + faults["length_scale"]["scale"])
    return position, outliers
