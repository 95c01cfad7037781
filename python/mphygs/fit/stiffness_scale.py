"""The common scale of all stiffnesses: found before all else is fitted, moved where a grid asks for it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import replace

import numpy as np

from mphygs.fit.problem import Problem
from mphygs.fit.start import DENSITY_FACTOR
from mphygs.model.belief import Belief
from mphygs.simulate.errors import SimulationError

# Parts are looked for by decades about the common scale, and about where a fit took them (see part_scales).
DECADE = 10.0
# How far a fit may take a part's stiffness from the scale that was found for it: a decade to either side is
# looked at, at a density that may be as far off as densities may. Without a bound a model that lacks an
# effect makes a part of jelly that its own weight crushes.
CONTRAST = DECADE * DENSITY_FACTOR
# So many times the stiffest other part: what is beyond may be a coarse grid's own.
FAR_STIFFER = 2.0
# A rest shape that has to be solved for takes long where it is too soft: after so many factors in a row that
# are worse than the best, softer ones are not tried.
PATIENCE = 2
# Common factors on all Young's moduli that are tried before anything else; share of the cost by which one
# beyond these has to be better than the one before.
SCALES, BETTER = tuple(10.0**k for k in (-1.5, -1.0, -0.5, 0.0, 0.5, 1.0, 1.5)), 0.01
# Between two of them half a swing of the motion may fit, and the valley with it: it is looked for halfway
# beside all that cost up to so many times the least, and once more beside the best of these.
HARDLY_WORSE = 2.0


def with_materials_at_prior(belief: Belief) -> Belief:
    """The belief with its free materials back at the middle of their priors, within the bounds that they had
    before a scale was found."""
    parameters = []
    for p in belief.parameters:
        if p.free and p.log and np.isfinite(p.prior_std) and p.key.rsplit(".", 1)[0] in belief.parts:
            p = p.widened()
            p = replace(p, value=float(np.clip(np.exp(p.prior_mean), p.lower, p.upper)))
        parameters.append(p)
    return replace(belief, parameters=tuple(parameters))


def stiffened(belief: Belief, factor: float) -> Belief:
    """The belief with all free Young's moduli times a factor, as far as their bounds allow."""
    for p in belief.free:
        if p.key.endswith(".youngs_modulus"):
            belief = belief.with_parameter(p.key, value=min(max(p.value * factor, p.lower), p.upper))
    return belief


def without_stiffest(belief: Belief) -> Belief | None:
    """The belief with the part in which waves are fastest, where it is far stiffer than every other, as stiff
    as the others are in the mean; None where no part is, or none of it is free.

    A coarse grid hides how a thick part bends: there it may turn into stone and fit as well.
    """
    moduli = {name: belief[f"{name}.youngs_modulus"] for name in belief.parts}
    if len(moduli) < 2:
        return None
    speed = {name: p.value / belief[f"{name}.density"].value for name, p in moduli.items()}
    fastest = max(speed, key=speed.__getitem__)
    others = [p.value for name, p in moduli.items() if name != fastest]
    stiffest = moduli[fastest]
    if not stiffest.free or stiffest.value < FAR_STIFFER * max(others):
        return None
    value = float(np.exp(np.mean(np.log(others))))
    return belief.with_parameter(stiffest.key, value=min(max(value, stiffest.lower), stiffest.upper))


def about_its_scale(belief: Belief) -> Belief:
    """The belief with each free Young's modulus kept within CONTRAST of where it is."""
    return replace(
        belief,
        parameters=tuple(
            p.narrowed(CONTRAST) if p.free and p.key.endswith(".youngs_modulus") else p
            for p in belief.parameters
        ),
    )


def at_scales(
    problem: Problem, belief: Belief, *, near: float = 1.0
) -> Iterator[tuple[float, float, Belief]]:
    """Common factors on all free Young's moduli, from stiff to soft, with the cost and the belief there;
    those that cannot be simulated left out.

    near: cost over the least so far from which a factor counts as worse (see PATIENCE).
    """
    least, worse = np.inf, 0
    for scale in sorted(SCALES, reverse=True):
        if np.isfinite(least) and worse >= PATIENCE and belief.prestress == "equilibrium":
            return
        worse += 1
        trial = stiffened(belief, scale)
        try:
            cost = problem.evaluate(trial, jacobian=False).cost
        except SimulationError:
            continue
        if cost < near * least:
            worse = 0
        least = min(least, cost)
        yield scale, cost, trial


def find_scale(problem: Problem, belief: Belief, report: Callable[[str], None] | None = None) -> Belief:
    """Move all free Young's moduli together to the factor that fits the first frames best: of the usual
    scales, beyond them as long as that fits better still, within their bounds, and of those between."""
    best, best_cost, at = None, np.inf, 1.0
    seen: dict[float, float] = {}

    def tried(scale: float, cost: float, trial: Belief) -> bool:
        nonlocal best, best_cost, at
        if report:
            report(f"scale {scale:.3g}: cost {cost:.4g}")
        seen[scale] = cost
        better = cost < (1.0 - BETTER) * best_cost
        if cost < best_cost:
            best, best_cost, at = trial, cost, scale
        return better

    for scale, cost, trial in at_scales(problem, belief):
        tried(scale, cost, trial)
    if best is None:
        raise SimulationError(
            f"no stiffness from {min(SCALES):.2g} to {max(SCALES):.2g} times the usual one could be "
            "simulated from the start"
        )
    step = SCALES[1] / SCALES[0]
    onward = step if at == max(seen) else 1.0 / step if at == min(seen) else None
    moved = best
    while onward is not None:
        trial = stiffened(moved, onward)
        if trial.free == moved.free:
            break  # at its bounds
        try:
            better = tried(at * onward, problem.evaluate(trial, jacobian=False).cost, trial)
        except SimulationError:
            break
        if not better:
            break
        moved = trial
    for apart, worse in ((step**0.5, HARDLY_WORSE), (step**0.25, 1.0)):
        near = [scale for scale, cost in seen.items() if cost <= worse * best_cost]
        for scale in sorted({round(scale * f, 9) for scale in near for f in (apart, 1.0 / apart)}):
            trial = stiffened(belief, scale)
            with suppress(SimulationError):
                tried(scale, problem.evaluate(trial, jacobian=False).cost, trial)
    return about_its_scale(best)


def simulable(problem: Problem, belief: Belief) -> Belief:
    """The belief, stiffened where another grid cannot carry what the grid before it could.

    Raises SimulationError when a factor of 64 does not help.
    """
    for factor in (1.0, 1.3, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0):
        trial = stiffened(belief, factor)
        try:
            problem.evaluate(trial, jacobian=False)
        except SimulationError as error:
            failure = error
            continue
        return trial
    raise failure
