"""Bounds with their sign for a stiffness that the data do not determine: a body that does not deform is at
least as stiff as would show.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from mphygs.fit.problem import Problem
from mphygs.model.belief import Belief
from mphygs.simulate.errors import SimulationError

# Rise of chi^2 that excludes a value: three standard deviations.
EXCLUDED = 9.0
# Factors by which a stiffness is moved either way, and halvings of the step in which the limit lies.
FACTORS, HALVINGS = (10.0, 100.0, 1000.0), 4


def one_sided(
    problem: Problem, belief: Belief, parameters: Mapping[str, Mapping[str, object]]
) -> dict[str, dict[str, float]]:
    """By key of a Young's modulus that is not determined, and that the measurements bound on one side alone:
    {"lower": ...} or {"upper": ...} [Pa].

    Everything else stays as it is. Priors have no say. What cannot be simulated does not fit, on the soft
    side; on the stiff side it says nothing.
    """
    found = {}
    for p in belief.free:
        if not p.key.endswith(".youngs_modulus") or parameters[p.key]["determined"]:
            continue
        here = problem.evaluate(belief, jacobian=False).chi_square

        def excluded(factor: float, key: str = p.key, limit: float = here + EXCLUDED) -> bool:
            value, own = belief[key].value * factor, belief[key]
            reach = {"lower": min(own.lower, value), "upper": max(own.upper, value)}
            trial = belief.with_parameter(key, value=value, **reach)
            try:
                return problem.evaluate(trial, jacobian=False).chi_square > limit
            except SimulationError:
                return factor < 1.0

        soft, stiff = (_limit(excluded, sign) for sign in (-1.0, 1.0))
        if soft is not None and stiff is None:
            found[p.key] = {"lower": float(p.value * soft)}
        elif stiff is not None and soft is None:
            found[p.key] = {"upper": float(p.value * stiff)}
    return found


def with_bounds(
    parameters: Mapping[str, Mapping[str, object]], bounds: Mapping[str, Mapping[str, float]]
) -> dict[str, dict[str, object]]:
    """The parameters with their bounds, and a note that says them."""
    told = {key: dict(entry) for key, entry in parameters.items()}
    for key, bound in bounds.items():
        ((side, value),) = bound.items()
        words = "at least" if side == "lower" else "at most"
        much = "softer would move more" if side == "lower" else "stiffer would move less"
        note = f"{words} {value:.2g} {told[key]['unit']}: what is {much} than is seen"
        told[key] |= {"bound": dict(bound), "note": f"{told[key].get('note', '')}; {note}".lstrip("; ")}
    return told


def _limit(excluded: Callable[[float], bool], sign: float) -> float | None:
    """Factor nearest to 1 that is excluded on one side, None where none of those tried is."""
    inside = 1.0
    for factor in FACTORS:
        outside = factor**sign
        if excluded(outside):
            for _ in range(HALVINGS):
                middle = float(np.sqrt(inside * outside))
                if excluded(middle):
                    outside = middle
                else:
                    inside = middle
            return outside
        inside = outside
    return None
