"""Parts that are far apart in stiffness: each one's own scale, where the common one leaves a part behind.

Beside a stem a hundred times as stiff a petal at the stem's modulus is rigid: it moves as the stem takes it
whatever its modulus, no tangent leads back, and bounds about the common scale would keep it from there.
So where a fit ends above the noise one part after the other is tried softer and stiffer by decades, beyond
and between those that tell nothing as well, which costs a few runs a part and no derivative; the fit goes on
from what fits better.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import numpy as np

from mphygs.fit.levenberg_marquardt import TOLERANCE, Solution, worth_a_step
from mphygs.fit.problem import Evaluation, Problem
from mphygs.fit.stiffness_scale import CONTRAST, DECADE
from mphygs.model.belief import Belief, Parameter
from mphygs.simulate.errors import SimulationError

# A fit that leaves less [sigma] has no part so far from its modulus that it shows: other parts, or more
# frames, would have to tell it.
LEFT = 2.0
# Decades in a row that are no better, and times the least cost that each of them may be, before a part is
# left: far above its stiffness it is rigid, at one of them as at the next. Shares of a decade between two.
PATIENCE, NO_WORSE, BETWEEN = 2, 1.25, (0.25, 0.5, 0.75)


def on_by_part(
    problem: Problem,
    found: Solution,
    again: Callable[[Belief], Solution],
    *,
    accuracy: float,
    say: Callable[[str], None] | None = None,
) -> Solution:
    """A solution of a problem, and on from where a part is softer or stiffer by decades as long as that fits
    better. One near the noise, or of a single stiffness, is left as it is.

    again: the fit from such a belief; accuracy: share of the cost that a last step of it may promise; say:
    told what moved.
    """
    while found.evaluation.misfit > LEFT:
        other = other_scales(problem, found.belief, found.evaluation, accuracy, say)
        if other is None:
            break
        on = again(other)
        found = replace(on, history=(*found.history, *on.history))
    return found


def other_scales(
    problem: Problem,
    belief: Belief,
    evaluation: Evaluation,
    accuracy: float,
    say: Callable[[str], None] | None = None,
) -> Belief | None:
    """The belief with every free stiffness moved by decades as far as each of them lowers the cost, one part
    after the other; None where no part brings what another step of a fit is worth (see `worth_a_step`).

    evaluation: of the belief. A part that moved has its bounds about its own scale.
    """
    keys = [p.key for p in belief.free if p.key.endswith(".youngs_modulus")]
    if len(keys) < 2:
        return None
    cost, worth, moved = evaluation.cost, worth_a_step(evaluation, TOLERANCE, accuracy), False
    for key in keys:
        for factor in _factors(belief[key]):
            lower, trial = _onward(problem, belief, key, factor, cost)
            if lower > cost - worth:
                continue
            if say:
                say(f"{key} {trial[key].value:.3g} Pa: cost {lower:.4g} of {cost:.4g}")
            belief, cost, moved = trial, lower, True
            break
    return belief if moved else None


def _factors(stiffness: Parameter) -> list[float]:
    """By which a stiffness is tried: less than a decade too where it ended at a bound about its scale, with
    the minimum just beyond."""
    factors = [1.0 / DECADE, DECADE]
    if stiffness.widest is None:
        return factors
    less = [DECADE**0.5, DECADE**0.25]
    if stiffness.widest[0] < stiffness.lower == stiffness.value:
        factors += [1.0 / factor for factor in less]
    elif stiffness.value == stiffness.upper < stiffness.widest[1]:
        factors += less
    return factors


def _onward(problem: Problem, belief: Belief, key: str, factor: float, cost: float) -> tuple[float, Belief]:
    """The lowest cost, and the belief there, with one stiffness times a factor, times its square and so on,
    until PATIENCE of them in a row were no better, one was worse, or none is left; and where they are much
    the same, with one between them: half a swing fits into less than a decade."""
    wide, best = belief[key].widened(), (cost, belief)

    def tried(value: float) -> float:
        nonlocal best
        own = replace(wide, value=value).narrowed(CONTRAST)
        trial = replace(belief, parameters=tuple(own if p.key == key else p for p in belief.parameters))
        try:
            reached = problem.evaluate(trial, jacobian=False).cost
        except SimulationError:
            return np.inf
        best = (reached, trial) if reached < best[0] else best
        return reached

    passed, worse, level = [wide.value], 0, False
    while worse < PATIENCE:
        value = min(max(passed[-1] * factor, wide.lower), wide.upper)
        if value == passed[-1]:
            break
        passed.append(value)
        before = best[0]
        reached = tried(value)
        if reached >= NO_WORSE * before:
            break
        level, worse = True, 0 if reached < before else worse + 1
    if level and cost < NO_WORSE * best[0]:
        for one, other in pairwise(passed):
            for share in BETWEEN:
                tried(one ** (1.0 - share) * other**share)
    return best
