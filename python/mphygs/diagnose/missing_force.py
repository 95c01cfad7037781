"""The force that a model lacks: the smallest field with which its motion is the measured one.

min over f, theta: 1/2 |L^-1 (y - h(theta, f))|^2 + 1/2 lambda |f|_W^2, with lambda such that chi^2 is about N
(Morozov's principle). The parameters give way for nothing and f is paid for, so that f does not restate them:
in a linear model this is the projection away from what refitting absorbs.

Gauss-Newton steps with the exact gradient, from the adjoint, and the Hessian of the natural modes at rest: a
step costs a run forward and a run back. A motion that is far off is followed from where it is not.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from mphygs.diagnose.missing_force_model import Channels, SeenForce
from mphygs.diagnose.missing_force_step import (
    STRONGEST,
    State,
    flat_values,
    gradient_of,
    learn,
    matrix_of,
    penalised_cost,
    penalised_step,
    state_at,
    stepped,
)
from mphygs.fit.problem import Problem
from mphygs.model.belief import Belief
from mphygs.simulate.errors import SimulationError
from mphygs.simulate.forced_motion import ForcedMotion, ForcedSequence

# Above this misfit [sigma] the motion is followed in stages, over these shares of the frames.
FAR = 3.0
STAGES = (0.3, 0.45, 0.6, 0.8, 1.0)
ITERATIONS, STAGE_ITERATIONS = 8, 3
# A step may promise to divide chi^2 by this much: beyond, the linear model is not to be believed.
BOLDEST = 10.0
# chi^2 within the first of these factors of N is good enough, beyond the second it is far. Of what is beyond
# noise within the third a step has to take this share for another one.
NEAR, STRAY, CLOSE, TAKES = 1.05, 1.3, 1.7, 0.3
# Levenberg's factor on the parameters, to begin with; they are held back more where a step fails.
DAMPING = 0.3


@dataclass(frozen=True, eq=False)
class SequenceForce:
    """The missing force of one sequence. values: (H, C, 3) [N/kg]; motion: with it."""

    seen_force: SeenForce
    values: np.ndarray
    motion: ForcedMotion
    residual: np.ndarray


@dataclass(frozen=True, eq=False)
class MissingForce:
    """belief: the parameters beside the force; before, after: chi^2 without and with it; rows: N."""

    belief: Belief
    found: Mapping[str, SequenceForce]
    before: float
    after: float
    rows: int
    strength: float

    @property
    def explained(self) -> float:
        """Share of the misfit beyond noise that the force takes away."""
        excess = max(self.before - self.rows, 1e-12)
        return float(np.clip((self.before - self.after) / excess, 0.0, 1.0))


def missing_force(
    problem: Problem,
    belief: Belief,
    *,
    start: Belief | None = None,
    iterations: int = ITERATIONS,
    report: Callable[[str], None] | None = None,
) -> MissingForce:
    """Find the force that a fitted model lacks on the frames of a problem.

    start: the same model fitted to the first frames, where one is known: the force is sought from there.
    Recordings of which no frame of the problem moves say nothing of a force and are left out.
    Raises SimulationError where not even the model without a force can be simulated, or no frame moves.
    """
    say = report or (lambda _text: None)
    begin = start or belief
    whole = {
        name: SeenForce.of(name, problem.predictors[name], begin, problem.observations[name], span)
        for name, span in problem.ranges.items()
        if len(ForcedSequence(problem.predictors[name], span[1]).timeline(begin).moving)
    }
    if not whole:
        raise SimulationError("no fitted frame moves: a force shows in none")
    values = {name: np.zeros(force.basis.shape) for name, force in whole.items()}
    state = state_at(problem, whole, belief, values)
    before, rows = state.chi_square, sum(len(r) for r in state.residuals.values())
    stages = _stages(problem, whole, begin, values) if before > FAR**2 * rows else STAGES[-1:]
    if len(stages) > 1:
        state = replace(state, belief=begin)
    channels_at, strength = state.belief, STRONGEST
    for share in stages:
        narrow, seen_forces = _narrowed(problem, whole, share)
        channels = {name: Channels.of(s, channels_at) for name, s in seen_forces.items()}
        state = state_at(problem, seen_forces, state.belief, state.values)
        count = iterations if share == stages[-1] else min(iterations, STAGE_ITERATIONS)
        state, strength = _descend(narrow, channels, state, count, share, say)
        channels_at = state.belief
    found = {
        n: SequenceForce(seen_forces[n], state.values[n], state.motions[n], state.residuals[n])
        for n in seen_forces
    }
    return MissingForce(state.belief, found, before, state.chi_square, rows, strength)


def _narrowed(
    problem: Problem, whole: Mapping[str, SeenForce], share: float
) -> tuple[Problem, dict[str, SeenForce]]:
    """The first share of the frames."""
    narrow = problem.narrowed(share) if share < 1.0 else problem
    return narrow, {name: s.until(narrow.ranges[name][1]) for name, s in whole.items()}


def _stages(
    problem: Problem, whole: Mapping[str, SeenForce], belief: Belief, values: dict[str, np.ndarray]
) -> tuple[float, ...]:
    """Shares of the frames in which a motion is followed: from the most on which it is not far off."""
    first = 0
    for k, share in enumerate(STAGES[:-1]):
        narrow, seen_forces = _narrowed(problem, whole, share)
        try:
            state = state_at(narrow, seen_forces, belief, values)
        except SimulationError:
            break
        if state.chi_square > FAR**2 * sum(len(r) for r in state.residuals.values()):
            break
        first = k
    return STAGES[first:]


def _descend(
    problem: Problem,
    channels: Mapping[str, Channels],
    state: State,
    iterations: int,
    share: float,
    say: Callable[[str], None],
) -> tuple[State, float]:
    """Steps until chi^2 is about N, or no step lowers it."""
    seen_forces = {name: c.seen_force for name, c in channels.items()}
    rows = sum(len(r) for r in state.residuals.values())
    keys = [p.key for p in state.belief.free]
    matrix = matrix_of(channels, state, keys)
    exact = matrix.exact
    strength, damping = STRONGEST, DAMPING
    before: tuple[np.ndarray, np.ndarray] | None = None
    for iteration in range(iterations):
        now = state.chi_square
        gradient = gradient_of(seen_forces, state, keys, exact)
        place = flat_values(state, state.belief.coordinates)
        if before is not None:
            learn(matrix.whole, place - before[0], gradient - before[1])
        before = (place, gradient)
        target = max(rows, now / BOLDEST)
        taken = None
        for length in (1.0, 0.6, 0.3, 0.1):
            # While the motion is far off, a stronger penalty would only give back what was gained.
            most = strength if now > STRAY * rows else STRONGEST
            strength, step, promised = penalised_step(matrix, state, gradient, now, target, damping, most)
            trial = stepped(problem, seen_forces, state, length * step, matrix)
            here = penalised_cost(state, seen_forces, strength)
            if trial is not None and penalised_cost(trial, seen_forces, strength) < here:
                taken = trial
                damping = max(0.3 * damping, 1e-3) if length == 1.0 else damping
                break
            damping *= 10.0
        if taken is None:
            break
        state = taken
        say(
            f"missing force, {share:.0%} of the frames, step {iteration + 1}: "
            f"{np.sqrt(state.chi_square / rows):.3f} sigma (promised {np.sqrt(max(promised, 0) / rows):.3f})"
        )
        left = state.chi_square
        if max(now, left) < NEAR * rows:
            break
        if left < CLOSE * rows and left - rows > (1.0 - TAKES) * (now - rows):
            break
    return state, strength
