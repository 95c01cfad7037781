"""One step of a least-squares fit: kept in its bounds, what it promises, how far it is damped.

Source: as for `mphygs.fit.levenberg_marquardt`.
"""

from __future__ import annotations

import numpy as np

from mphygs.model.belief import Belief

# Marquardt's damping of the first step, and the least of any, in units of the diagonal.
FIRST_DAMPING, LEAST_DAMPING = 1e-3, 1e-9


def bounded_step(belief: Belief, normal: np.ndarray, gradient: np.ndarray) -> np.ndarray:
    """Solve normal * step = -gradient with the coordinates kept in their bounds.

    A coordinate whose step leads out of its bound is put there and taken out of the system; the
    system is small, so this is repeated until none is left.
    """
    free = belief.free
    now = belief.coordinates
    low, high = (
        np.array([np.log(b) if p.log else b / p.scale for p, b in zip(free, bounds, strict=True)])
        for bounds in ([p.lower for p in free], [p.upper for p in free])
    )
    step = np.zeros(len(now))
    active = np.zeros(len(now), bool)
    for _ in range(len(now) + 1):
        inside = ~active
        if not inside.any():
            break
        right = -gradient[inside] - normal[np.ix_(inside, active)] @ step[active]
        step[inside] = np.linalg.lstsq(normal[np.ix_(inside, inside)], right, rcond=1e-13)[0]
        out = inside & ((now + step < low - 1e-12) | (now + step > high + 1e-12))
        if not out.any():
            break
        step[out] = np.clip(now + step, low, high)[out] - now[out]
        active |= out
    return step


def promised_by(normal: np.ndarray, gradient: np.ndarray, step: np.ndarray) -> float:
    """The fall of the cost that a step would bring, were the residual linear."""
    return -float(gradient @ step + 0.5 * step @ normal @ step)


def worthwhile_damping(
    belief: Belief, normal: np.ndarray, gradient: np.ndarray, damping: float, worth: float
) -> float:
    """The damping, or the largest below it, in stages, at which a step promises what it is worth taking for.

    Along a narrow valley a damped step promises nothing, however far the valley falls: only what an undamped
    one promises as little tells a minimum.
    """
    diagonal = np.diag(np.maximum(np.diag(normal), 1e-12))
    less = damping
    while less >= LEAST_DAMPING:
        if promised_by(normal, gradient, bounded_step(belief, normal + less * diagonal, gradient)) >= worth:
            return less
        less *= 0.1
    return damping


def secant(
    jacobian: np.ndarray, before: np.ndarray, after: np.ndarray, step: np.ndarray, scale: np.ndarray
) -> np.ndarray:
    """The Jacobian that is nearest, in units of `scale`, and explains how the residual changed."""
    weighted = scale * step
    return jacobian + np.outer(after - before - jacobian @ step, weighted / max(weighted @ step, 1e-300))
