"""Steps in time by the generalised alpha method (Chung and Hulbert 1993), with turns (Arnold, Bruels 2007).

Of second order. What is far faster than a step fades, what is slower keeps its swing: of a motion of w
[rad/s] with steps of h the share of critical damping is of the order of (w h)^3.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple, Protocol

import numpy as np
from scipy.sparse import coo_matrix, csc_matrix
from scipy.sparse.linalg import SuperLU, splu

# Spectral radius at infinite frequency: what a step leaves of the fastest.
LEFT = 0.7
# Newton's steps end where no unknown changes by more than this [m, rad]. Factors are made anew where a
# correction is no smaller than this share of the one before: they cost tens of corrections.
CONVERGED, STALE = 1e-10, 0.4
MOST_CORRECTIONS = 60

State = object


class Structure(Protocol):
    """N nodes of D unknowns each; the first three are a displacement [m]. held: (N,) bool; inertia: sparse
    (N D, N D) mass."""

    held: np.ndarray
    inertia: csc_matrix

    def moved(self, state: State, change: np.ndarray) -> State:
        """The state after a change (N, D) of all unknowns."""
        ...

    def imposed(self, state: State, time: float) -> State:
        """The state with held nodes where they are at a time [s]."""
        ...

    def surplus(
        self, state: State, velocity: np.ndarray, before: State, time: float, step: float
    ) -> np.ndarray:
        """(N, D) internal less external forces, with what a turning inertia adds.

        velocity: (N, D); before: the state a step [s] ago.
        """
        ...

    def slope(self, state: State, before: State, step: float) -> csc_matrix:
        """(N D, N D) of the internal forces."""
        ...


class Moment(NamedTuple):
    """state, velocity (N, D) and acceleration (N, D) at one time; those of held nodes are zero."""

    state: State
    velocity: np.ndarray
    acceleration: np.ndarray


def march(structure: Structure, start: State, begin: float, step: float, count: int) -> Iterator[Moment]:
    """The structure from rest at `begin` [s], after each of `count` steps [s].

    Raises RuntimeError where a step is not found.
    """
    alpha_m, alpha_f = (2.0 * LEFT - 1.0) / (LEFT + 1.0), LEFT / (LEFT + 1.0)
    gamma = 0.5 + alpha_f - alpha_m
    beta = 0.25 * (gamma + 0.5) ** 2
    per_change = (1.0 - alpha_m) / (step**2 * beta * (1.0 - alpha_f))
    shape = (len(structure.held), structure.inertia.shape[0] // len(structure.held))
    free = np.repeat(~structure.held, shape[1])
    inside = structure.inertia[free][:, free]

    def solved(factors: SuperLU, right: np.ndarray) -> np.ndarray:
        out = np.zeros(free.shape)
        out[free] = factors.solve(right.ravel()[free])
        return out.reshape(shape)

    state, velocity = structure.imposed(start, begin), np.zeros(shape)
    pushed = structure.surplus(state, velocity, state, begin, step)
    acceleration = solved(splu(csc_matrix(inside)), -pushed)
    algorithmic = acceleration
    factors = None
    for k in range(1, count + 1):
        time, before = begin + k * step, state
        drift = velocity + (0.5 - beta) * step * algorithmic
        speed = velocity + (1.0 - gamma) * step * algorithmic
        algorithmic = (alpha_f * acceleration - alpha_m * algorithmic) / (1.0 - alpha_m)
        change = step * (drift + beta * step * algorithmic)
        velocity, acceleration = speed + gamma * step * algorithmic, np.zeros(shape)
        state = structure.imposed(structure.moved(before, change), time)
        size = np.inf
        for _ in range(MOST_CORRECTIONS):
            right = (structure.inertia @ acceleration.ravel()).reshape(shape)
            right = right + structure.surplus(state, velocity, before, time, step)
            if factors is None:
                slope = structure.slope(state, before, step)[free][:, free]
                factors = splu(csc_matrix(slope + per_change * inside))
            correction = solved(factors, -right)
            last, size = size, float(np.abs(correction).max())
            if not np.isfinite(size):
                break
            state = structure.moved(state, correction)
            velocity = velocity + gamma / (step * beta) * correction
            acceleration = acceleration + per_change * correction
            if size < CONVERGED:
                break
            if size > STALE * last:
                factors = None
        if not size < CONVERGED:
            raise RuntimeError(f"no step of {step:.3g} s is found at {time:.4g} s; shorter steps may be")
        algorithmic = algorithmic + (1.0 - alpha_f) / (1.0 - alpha_m) * acceleration
        yield Moment(state, velocity, acceleration)


def summed_blocks(blocks: np.ndarray, entry: np.ndarray, size: int) -> csc_matrix:
    """Sparse sum of blocks (B, n, n) at rows and columns `entry` (B, n)."""
    rows = np.broadcast_to(entry[:, :, None], blocks.shape)
    columns = np.broadcast_to(entry[:, None, :], blocks.shape)
    return csc_matrix(coo_matrix((blocks.ravel(), (rows.ravel(), columns.ravel())), shape=(size, size)))
