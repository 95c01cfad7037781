"""One step towards the force that a model lacks: its gradient and curvature, and where it leads."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from mphygs.diagnose.missing_force_model import Channels, SeenForce, curvature
from mphygs.fit.problem import Problem
from mphygs.model.belief import Belief
from mphygs.simulate.errors import SimulationError
from mphygs.simulate.forced_motion import ForcedMotion
from mphygs.simulate.scope import acts_in_simulation

LARGEST_LOG_STEP = 0.7
WEAKEST, STRONGEST = 1e-6, 1e8


@dataclass(frozen=True, eq=False)
class State:
    """A force and a model beside it. values: (H, C, 3) [N/kg] of every sequence; residuals: whitened, (N,);
    prior, prior_slope: rows of the model's priors and their derivative by the coordinates."""

    belief: Belief
    values: dict[str, np.ndarray]
    motions: dict[str, ForcedMotion]
    residuals: dict[str, np.ndarray]
    prior: np.ndarray
    prior_slope: np.ndarray

    @property
    def chi_square(self) -> float:
        """Of the markers of all sequences."""
        return sum(float(r @ r) for r in self.residuals.values())


def state_at(
    problem: Problem, seen_forces: Mapping[str, SeenForce], belief: Belief, values: dict[str, np.ndarray]
) -> State:
    """The motion with a force. Raises SimulationError."""
    runs = {name: s.run(belief, values[name]) for name, s in seen_forces.items()}
    prior = problem.prior_rows(belief)
    return State(
        belief, values, {n: m for n, (m, _) in runs.items()}, {n: r for n, (_, r) in runs.items()}, *prior
    )


@dataclass(frozen=True, eq=False)
class _Matrix:
    """whole: approximate J^T J of all unknowns, the coordinates last; penalty: W of all; exact: by sequence,
    the whitened change by the coordinates; slices: of every sequence's values."""

    whole: np.ndarray
    penalty: np.ndarray
    exact: dict[str, np.ndarray]
    slices: dict[str, slice]


def matrix_of(channels: Mapping[str, Channels], state: State, keys: list[str]) -> _Matrix:
    """The approximate curvature at a state."""
    sizes = {n: state.values[n].size for n in channels}
    total, count = sum(sizes.values()), len(keys)
    whole, penalty = np.zeros((total + count,) * 2), np.zeros((total + count,) * 2)
    exact, slices, at = {}, {}, 0
    last = slice(total, total + count)
    for name, channel in channels.items():
        block, exact[name] = curvature(channel, state.motions[name], keys)
        mine = slice(at, at + sizes[name])
        at += sizes[name]
        slices[name] = mine
        inner = slice(0, sizes[name])
        outer = slice(sizes[name], sizes[name] + count)
        whole[mine, mine] += block[inner, inner]
        whole[mine, last] += block[inner, outer]
        whole[last, mine] += block[outer, inner]
        whole[last, last] += block[outer, outer]
        penalty[mine, mine] = np.kron(channel.seen_force.basis.roughness, np.eye(3))
    return _Matrix(whole, penalty, exact, slices)


def gradient_of(
    seen_forces: Mapping[str, SeenForce], state: State, keys: list[str], exact: Mapping[str, np.ndarray]
) -> np.ndarray:
    """Of half of chi^2 by all unknowns: exact, but for parameters that do not act in the simulation."""
    simulated = [k for k in keys if acts_in_simulation(state.belief[k])]
    pieces, coordinates = [], np.zeros(len(keys))
    for name, s in seen_forces.items():
        by_force, slopes = s.gradient(state.motions[name], state.residuals[name], simulated)
        pieces.append(by_force.ravel())
        own = -exact[name].T @ state.residuals[name]
        for k, slope in zip(simulated, slopes, strict=True):
            own[keys.index(k)] = slope
        coordinates += own
    return np.concatenate([*pieces, coordinates])


def flat_values(state: State, coordinates: np.ndarray) -> np.ndarray:
    """All unknowns' present values, (U + K,)."""
    return np.concatenate([*(v.ravel() for v in state.values.values()), coordinates])


def learn(whole: np.ndarray, moved: np.ndarray, change: np.ndarray) -> None:
    """Correct the Hessian by how the exact gradient changed over a step (BFGS)."""
    seen = whole @ moved
    expected, actual = float(moved @ seen), float(moved @ change)
    if actual > 0.05 * expected > 0.0:
        whole += np.outer(change, change) / actual - np.outer(seen, seen) / expected


def penalised_step(
    matrix: _Matrix,
    state: State,
    gradient: np.ndarray,
    now: float,
    target: float,
    damping: float,
    most: float,
) -> tuple[float, np.ndarray, float]:
    """The strength of the penalty at which the step is expected to reach the target; the step; chi^2 then."""
    own = state.prior_slope.T @ state.prior_slope
    pull = state.prior_slope.T @ state.prior
    count = len(own)
    base = matrix.whole.copy()
    corner = base[len(base) - count :, len(base) - count :]
    corner += own + damping * np.diag(np.diag(corner)) + 1e-9 * np.eye(count)
    # The coordinates are not paid for.
    fixed = matrix.penalty @ flat_values(state, np.zeros(count))
    slope = gradient.copy()
    slope[len(slope) - count :] += pull
    # Against rounding alone.
    base[np.diag_indices(len(base))] *= 1.0 + 1e-9

    def solve(strength: float) -> tuple[np.ndarray, float]:
        step = -cho_solve(cho_factor(base + strength * matrix.penalty), slope + strength * fixed)
        return step, now + 2.0 * float(gradient @ step) + float(step @ matrix.whole @ step)

    low, high = np.log(WEAKEST), np.log(most)
    for _ in range(8):
        middle = 0.5 * (low + high)
        _, promised = solve(np.exp(middle))
        low, high = (middle, high) if promised < target else (low, middle)
    strength = float(np.exp(low))
    return strength, *solve(strength)


def stepped(
    problem: Problem, seen_forces: Mapping[str, SeenForce], state: State, step: np.ndarray, matrix: _Matrix
) -> State | None:
    """The state after a step, None where it cannot be simulated."""
    count = len(state.belief.free)
    coordinates = step[len(step) - count :].copy()
    logs = np.array([p.log for p in state.belief.free], bool)
    if logs.any():
        coordinates[logs] = np.clip(coordinates[logs], -LARGEST_LOG_STEP, LARGEST_LOG_STEP)
    values = {n: v + step[matrix.slices[n]].reshape(v.shape) for n, v in state.values.items()}
    try:
        return state_at(problem, seen_forces, state.belief.at(state.belief.coordinates + coordinates), values)
    except SimulationError:
        return None


def penalised_cost(state: State, seen_forces: Mapping[str, SeenForce], strength: float) -> float:
    """Half of chi^2, of the priors and of the penalty on rough forces."""
    square = sum(s.basis.square(state.values[n]) for n, s in seen_forces.items())
    return 0.5 * (state.chi_square + float(state.prior @ state.prior) + strength * square)
