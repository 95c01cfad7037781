"""From a missing force to the regression that a formula comes from.

The data are what the markers would be off by if the force were taken away, to first order along a motion that
is nearly the measured one; they do not depend on how strongly the force was smoothed. The parameters beside a
free force may be far from those beside a formula, and the first order is then not enough: the motion is
computed again with the best formula so far in place of the force, parameters and coefficients refitted, and
the formula is sought again from there.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from mphygs.diagnose.force_features import KINDS, Feature, PointMotion, candidate_features
from mphygs.diagnose.force_formula import Formula, Regression, find_formula
from mphygs.diagnose.missing_force import MissingForce, SequenceForce
from mphygs.diagnose.missing_force_model import Channels
from mphygs.fit.damped_step import secant
from mphygs.fit.problem import Problem
from mphygs.model.belief import Belief
from mphygs.simulate.errors import SimulationError

# Features whose tangents are computed exactly, the best by the natural modes; and so many the next times.
FINALISTS, KEPT = 16, 8
BLOCK_FRAMES = 5
# Times that the formula is put in place of the force; of its refit the steps, the times that their tangents
# are computed anew, and the share of the cost that a step has to bring for another one.
ROUNDS, STEPS, ANEW, WORTH = 2, 10, 2, 1e-2
LARGEST_STEP = 0.7


@dataclass(frozen=True, eq=False)
class Base:
    """A motion to linearise about. found: the run of every sequence, with its force."""

    belief: Belief
    found: Mapping[str, SequenceForce]

    @property
    def residual(self) -> np.ndarray:
        """(N,) whitened residual, measured - predicted, all sequences one after the other."""
        return np.concatenate([f.residual for f in self.found.values()])

    @property
    def chi_square(self) -> float:
        """Sum of squares of the whitened residuals of all sequences."""
        return float(self.residual @ self.residual)


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
    features = candidate_features(motions[first], mean_course(missing.found[first]))
    if len(features) > FINALISTS:
        features = _screened(missing, motions, features)
    # Along the motion that is nearly the measured one, once and for all.
    feature_forces = {n: np.stack([f.forces(motion) for f in features]) for n, motion in motions.items()}
    base = Base(missing.belief, missing.found)
    for number in range(ROUNDS):
        linear = _linearised(base, feature_forces)
        regression = linear.regression()
        whole = np.ones(len(regression.rows))
        chosen = regression.chosen(whole)
        if not chosen:
            break
        coefficients, shift, share = regression.fit(chosen, whole)
        terms = [f"{c:.3g} {features[k].expression}" for k, c in zip(chosen, coefficients, strict=True)]
        say(f"formula, round {number + 1}: {', '.join(terms)} for {share:.1%} of the misfit")
        theirs = {n: o[list(chosen)] for n, o in feature_forces.items()}
        moved = _refitted(problem, base, theirs, linear.of(chosen), coefficients, shift)
        if moved is None:
            break
        base = moved
        kept = sorted(regression.best(KEPT))
        features = [features[k] for k in kept]
        feature_forces = {n: o[kept] for n, o in feature_forces.items()}
        rows = sum(len(f.residual) for f in base.found.values())
        say(f"formula, round {number + 1}: {np.sqrt(base.chi_square / rows):.3f} sigma in place of the force")
    expressions, units = [f.expression for f in features], [f.unit for f in features]
    # Of forces that are not told apart, the one that can be added to the model.
    simple = [KINDS[f.kind].code is not None for f in features]
    regression = _linearised(base, feature_forces).regression()
    formula = find_formula(regression, expressions, units, simple, generator=generator)
    return Explained(formula, tuple(features[t.index] for t in formula.terms))


@dataclass(frozen=True, eq=False)
class _Linear:
    """Whitened, all sequences: data (N,), the residual without a force; features (N, K), parameters (N, P):
    how the markers move by each; block (N,) of every row."""

    data: np.ndarray
    features: np.ndarray
    parameters: np.ndarray
    block: np.ndarray

    def regression(self) -> Regression:
        """The sums that a formula is sought in."""
        return Regression.of(self.data, self.features, self.parameters, self.block)

    def of(self, chosen: Sequence[int]) -> _Linear:
        """With some of the features."""
        return replace(self, features=self.features[:, list(chosen)])


def _linearised(base: Base, feature_forces: Mapping[str, np.ndarray]) -> _Linear:
    keys = [p.key for p in base.belief.free]
    data, columns, parameters, blocks = [], [], [], []
    for number, (name, found) in enumerate(base.found.items()):
        seen_force, count = found.seen_force, len(feature_forces[name])
        change = seen_force.whitened(
            seen_force.forced.tangents(found.motion, [found.motion.force, *feature_forces[name]], keys)
        )
        data.append(found.residual + change[:, 0])
        columns.append(change[:, 1 : 1 + count])
        parameters.append(change[:, 1 + count :])
        blocks.append(1000 * number + seen_force.whitener.frame // BLOCK_FRAMES)
    return _Linear(*(np.concatenate(x) for x in (data, columns, parameters, blocks)))


def _at(base: Base, belief: Belief, feature_forces: Mapping[str, np.ndarray], numbers: np.ndarray) -> Base:
    """The runs with the forces of features, (K, T, N, 3) each, times numbers (K,). Raises SimulationError."""
    found = {}
    for name, old in base.found.items():
        motion = old.seen_force.forced.run(belief, np.tensordot(numbers, feature_forces[name], axes=1))
        residual = old.seen_force.whitened(motion.position, measured=True)
        found[name] = replace(old, motion=motion, residual=residual)
    return Base(belief, found)


def _refitted(
    problem: Problem,
    base: Base,
    feature_forces: Mapping[str, np.ndarray],
    linear: _Linear,
    numbers: np.ndarray,
    shift: np.ndarray,
) -> Base | None:
    """The base with terms in place of its force, coefficients and parameters refitted to the measurement by
    Levenberg-Marquardt steps. None where it cannot be simulated.

    linear: about the base, of these terms. Its slopes lead on, corrected by what every step brought
    (Broyden's secants); they are computed anew where a step does not lower the cost.
    """

    def moved(belief: Belief, step: np.ndarray) -> Belief:
        return belief.at(belief.coordinates + np.clip(step, -LARGEST_STEP, LARGEST_STEP))

    def cost(one: Base) -> float:
        prior, _ = problem.prior_rows(one.belief)
        return one.chi_square + float(prior @ prior)

    def attempt(belief: Belief, trial_numbers: np.ndarray) -> Base | None:
        try:
            return _at(base, belief, feature_forces, trial_numbers)
        except SimulationError:
            return None

    # The first order may promise too large a shift.
    trials = [attempt(moved(base.belief, share * shift), numbers) for share in (1.0, 0.5, 0.0)]
    now = min((t for t in trials if t is not None), key=cost, default=None)
    if now is None:
        return None
    count, damping, anew, failed = len(numbers), 1e-2, 0, 0
    came = np.r_[numbers, now.belief.coordinates - base.belief.coordinates]
    slopes = _secant(np.hstack([linear.features, linear.parameters]), linear.data, now.residual, came)
    fresh = False
    for _ in range(STEPS):
        matrix, right = _normal(problem, now, slopes)
        step = np.linalg.lstsq(matrix + damping * np.diag(np.diag(matrix)), right, rcond=1e-12)[0]
        trial = attempt(moved(now.belief, step[count:]), numbers + step[:count])
        if trial is None or cost(trial) >= cost(now):
            if fresh:
                damping, failed = 10.0 * damping, failed + 1
            elif anew < ANEW:
                slopes, fresh, anew = _slopes(now, feature_forces), True, anew + 1
            if not fresh or failed == 4:
                break
            continue
        fell = cost(now) - cost(trial)
        came = np.r_[step[:count], trial.belief.coordinates - now.belief.coordinates]
        slopes = _secant(slopes, now.residual, trial.residual, came)
        now, numbers, damping, fresh, failed = trial, numbers + step[:count], 0.1 * damping, False, 0
        if fell < WORTH * cost(now):
            break
    return now


def _secant(slopes: np.ndarray, before: np.ndarray, after: np.ndarray, step: np.ndarray) -> np.ndarray:
    """Slopes of the prediction, put right by how residuals (measured - predicted) changed over a step."""
    return -secant(-slopes, before, after, step, (slopes**2).sum(0))


def _slopes(now: Base, feature_forces: Mapping[str, np.ndarray]) -> np.ndarray:
    """(N, K + P) whitened change of the markers by coefficients and parameters, all sequences."""
    keys = [p.key for p in now.belief.free]
    return np.concatenate(
        [
            f.seen_force.whitened(f.seen_force.forced.tangents(f.motion, list(feature_forces[n]), keys))
            for n, f in now.found.items()
        ]
    )


def _normal(problem: Problem, now: Base, slopes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Normal equations of coefficients and parameters, priors among them."""
    prior, slope = problem.prior_rows(now.belief)
    count = slopes.shape[1] - slope.shape[1]
    matrix = np.concatenate([np.hstack([np.zeros((len(prior), count)), -slope]), slopes])
    right = np.concatenate([prior, now.residual])
    return matrix.T @ matrix, matrix.T @ right


def mean_course(found: SequenceForce) -> np.ndarray:
    """(T, 3) [N/kg] mean force over the mass, at the frames in use."""
    basis = found.seen_force.basis
    course = basis.over_time(found.values)[: found.seen_force.last]
    return np.einsum("c,tcd->td", basis.mass / basis.mass.sum(), course)


def _screened(
    missing: MissingForce, motions: Mapping[str, PointMotion], features: list[Feature]
) -> list[Feature]:
    """The features that come first when all are added one by one, by the cheap map of the natural modes."""
    gram, right = 0.0, 0.0
    for name, found in missing.found.items():
        channels = Channels.of(found.seen_force, missing.belief)
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
