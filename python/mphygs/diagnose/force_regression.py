"""From a missing force to the regression that a formula comes from.

The data are what the markers would be off by if the force were taken away, to first order along a motion that
is nearly the measured one; they do not depend on how strongly the force was smoothed. The parameters beside a
free force may be far from those beside a formula, and the first order is then not enough: the motion is
computed again with the best formula so far in place of the force, parameters and coefficients refitted, and
the formula is sought again from there.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from mphygs.diagnose.force_features import KINDS, Feature, PointMotion, library
from mphygs.diagnose.force_formula import Formula, Regression, find_formula
from mphygs.diagnose.missing_force import Found, MissingForce
from mphygs.diagnose.missing_force_model import Channels
from mphygs.fit.problem import Problem
from mphygs.model.belief import Belief
from mphygs.simulate.errors import SimulationError

# Features whose tangents are computed exactly, the best by the natural modes; and so many the next times.
FINALISTS, KEPT = 16, 8
BLOCK_FRAMES = 5
# Times that the formula is put in place of the force, steps of its refit, and the share of the cost that a
# step has to bring for another one.
ROUNDS, STEPS, WORTH = 2, 4, 1e-2
LARGEST_STEP = 0.7


@dataclass(frozen=True, eq=False)
class Base:
    """A motion to linearise about. found: the run of every sequence, with its force."""

    belief: Belief
    found: Mapping[str, Found]

    @property
    def chi_square(self) -> float:
        """Sum of squares of the whitened residuals of all sequences."""
        return sum(float(f.residual @ f.residual) for f in self.found.values())


@dataclass(frozen=True, eq=False)
class Explained:
    """A formula and the feature of each of its terms."""

    formula: Formula
    features: tuple[Feature, ...]


def formula_of(
    problem: Problem,
    missing: MissingForce,
    *,
    generator: np.random.Generator,
    report: Callable[[str], None] | None = None,
) -> Explained:
    """A formula for a missing force, sought on the frames of a problem."""
    say = report or (lambda _text: None)
    motions = {name: PointMotion.of(found) for name, found in missing.found.items()}
    first = next(iter(missing.found))
    features = library(motions[first], mean_course(missing.found[first]))
    if len(features) > FINALISTS:
        features = _screened(missing, motions, features)
    # Along the motion that is nearly the measured one, once and for all.
    own = {n: np.stack([f.forces(motion) for f in features]) for n, motion in motions.items()}
    base = Base(missing.belief, missing.found)
    for number in range(ROUNDS):
        regression = _regression(base, own)
        whole = np.ones(len(regression.rows))
        chosen = regression.chosen(whole)
        if not chosen:
            break
        coefficients, shift, share = regression.fit(chosen, whole)
        terms = [f"{c:.3g} {features[k].expression}" for k, c in zip(chosen, coefficients, strict=True)]
        say(f"formula, round {number + 1}: {', '.join(terms)} for {share:.1%} of the misfit")
        moved = _refitted(problem, base, {n: o[list(chosen)] for n, o in own.items()}, coefficients, shift)
        if moved is None:
            break
        base = moved
        kept = sorted(regression.best(KEPT))
        features, own = [features[k] for k in kept], {n: o[kept] for n, o in own.items()}
        rows = sum(len(f.residual) for f in base.found.values())
        say(f"formula, round {number + 1}: {np.sqrt(base.chi_square / rows):.3f} sigma in place of the force")
    expressions, units = [f.expression for f in features], [f.unit for f in features]
    # Of forces that are not told apart, the one that can be added to the model.
    simple = [KINDS[f.kind].code is not None for f in features]
    formula = find_formula(_regression(base, own), expressions, units, simple, generator=generator)
    return Explained(formula, tuple(features[t.index] for t in formula.terms))


def _regression(base: Base, own: Mapping[str, np.ndarray]) -> Regression:
    keys = [p.key for p in base.belief.free]
    data, columns, parameters, blocks = [], [], [], []
    for number, (name, found) in enumerate(base.found.items()):
        seen, count = found.seen, len(own[name])
        change = seen.whitened(seen.forced.tangents(found.motion, [found.motion.force, *own[name]], keys))
        data.append(found.residual + change[:, 0])
        columns.append(change[:, 1 : 1 + count])
        parameters.append(change[:, 1 + count :])
        blocks.append(1000 * number + seen.whitener.frame // BLOCK_FRAMES)
    return Regression.of(*(np.concatenate(x) for x in (data, columns, parameters, blocks)))


def _at(base: Base, belief: Belief, own: Mapping[str, np.ndarray], numbers: np.ndarray) -> Base:
    """The runs with the forces own (K, T, N, 3) times numbers (K,). Raises SimulationError."""
    found = {}
    for name, old in base.found.items():
        motion = old.seen.forced.run(belief, np.tensordot(numbers, own[name], axes=1))
        residual = old.seen.whitened(motion.position, measured=True)
        found[name] = replace(old, motion=motion, residual=residual)
    return Base(belief, found)


def _refitted(
    problem: Problem, base: Base, own: Mapping[str, np.ndarray], numbers: np.ndarray, shift: np.ndarray
) -> Base | None:
    """The base with terms in place of its force, coefficients and parameters refitted to the measurement by
    Levenberg-Marquardt steps. None where it cannot be simulated."""

    def moved(belief: Belief, step: np.ndarray) -> Belief:
        return belief.at(belief.coordinates + np.clip(step, -LARGEST_STEP, LARGEST_STEP))

    def cost(one: Base) -> float:
        prior, _ = problem.prior_rows(one.belief)
        return one.chi_square + float(prior @ prior)

    now = None
    # The first order may promise too large a shift.
    for share in (1.0, 0.5, 0.0):
        try:
            trial = _at(base, moved(base.belief, share * shift), own, numbers)
        except SimulationError:
            continue
        if now is None or cost(trial) < cost(now):
            now = trial
    if now is None:
        return None
    damping, count = 1e-2, len(numbers)
    for _ in range(STEPS):
        matrix, right = _normal(problem, now, own)
        for _attempt in range(4):
            damped = matrix + damping * np.diag(np.diag(matrix))
            step = np.linalg.lstsq(damped, right, rcond=1e-12)[0]
            try:
                trial = _at(base, moved(now.belief, step[count:]), own, numbers + step[:count])
            except SimulationError:
                damping *= 10.0
                continue
            if cost(trial) < cost(now):
                break
            damping *= 10.0
        else:
            return now
        fell = cost(now) - cost(trial)
        now, numbers, damping = trial, numbers + step[:count], 0.1 * damping
        if fell < WORTH * cost(now):
            break
    return now


def _normal(problem: Problem, now: Base, own: Mapping[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Normal equations of coefficients and parameters, priors among them."""
    keys = [p.key for p in now.belief.free]
    prior, slope = problem.prior_rows(now.belief)
    count = len(next(iter(own.values())))
    columns, residuals = [np.hstack([np.zeros((len(prior), count)), -slope])], [prior]
    for name, found in now.found.items():
        columns.append(found.seen.whitened(found.seen.forced.tangents(found.motion, list(own[name]), keys)))
        residuals.append(found.residual)
    matrix, right = np.concatenate(columns), np.concatenate(residuals)
    return matrix.T @ matrix, matrix.T @ right


def mean_course(found: Found) -> np.ndarray:
    """(T, 3) [N/kg] mean force over the mass, at the frames in use."""
    basis = found.seen.basis
    course = basis.over_time(found.values)[: found.seen.last]
    return np.einsum("c,tcd->td", basis.mass / basis.mass.sum(), course)


def _screened(
    missing: MissingForce, motions: Mapping[str, PointMotion], features: list[Feature]
) -> list[Feature]:
    """The features that come first when all are added one by one, by the cheap map of the natural modes."""
    gram, right = 0.0, 0.0
    for name, found in missing.found.items():
        channels = Channels.of(found.seen, missing.belief)
        forces = np.stack([f.forces(motions[name]) for f in features] + [found.motion.force], axis=-1)
        moved = channels.of_node_forces(found.motion, forces)
        gram = gram + moved[:, :-1].T @ moved[:, :-1]
        right = right + moved[:, :-1].T @ moved[:, -1]
    alone = right**2 / np.maximum(np.diag(gram), 1e-300)
    chosen: list[int] = []
    best_of_kind = {f.kind for f in features}
    # Every kind gets a hearing: the best of it, then the best of all.
    for kind in sorted(best_of_kind):
        mine = [k for k, f in enumerate(features) if f.kind == kind]
        chosen.append(max(mine, key=lambda k: alone[k]))
    for k in np.argsort(-alone):
        if len(chosen) >= FINALISTS:
            break
        if k not in chosen:
            chosen.append(int(k))
    return [features[k] for k in sorted(chosen)]
