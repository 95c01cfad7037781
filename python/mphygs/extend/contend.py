"""Candidates put into the model and refitted under feedback, and what they predict of what was not fitted."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from mphygs.compare.assess import Compared, whiten_all
from mphygs.diagnose.criteria import CRITERIA, Criteria
from mphygs.diagnose.scan import Scored
from mphygs.fit.experiment import Experiment
from mphygs.fit.levenberg_marquardt import Solution, minimise
from mphygs.fit.problem import Evaluation, Problem
from mphygs.fit.side_by_side import side_by_side
from mphygs.model.belief import Belief
from mphygs.simulate.errors import FAILURES, SimulationError


@dataclass(frozen=True, eq=False)
class Predictive:
    """How well a model predicts, block by block: (B,) log-likelihoods; seen: (B,) whether it was fitted;
    count: (B,) numbers in each."""

    log_score: np.ndarray
    seen: np.ndarray
    count: np.ndarray

    @property
    def misfit(self) -> tuple[float, float]:
        """Root mean square [sigma] of what was fitted, and of what was not (of both where there is no
        such)."""

        def rms(rows: np.ndarray) -> float:
            rows = rows if rows.any() else np.ones_like(rows)
            return float(np.sqrt(-2.0 * self.log_score[rows].sum() / max(self.count[rows].sum(), 1)))

        return rms(self.seen), rms(~self.seen)


def predictive(compared: dict[str, Compared], criteria: Criteria = CRITERIA) -> Predictive:
    """The log scores of a comparison, in blocks of frames whose errors hang together."""
    w = whiten_all(compared)
    block = w.sequence * 1_000_000 + 2 * (w.frame // criteria.block_frames) + w.seen
    _, first, index = np.unique(block, return_index=True, return_inverse=True)
    log = np.bincount(index, -0.5 * w.residual**2)
    return Predictive(log, w.seen[first], np.bincount(index).astype(float))


def gain_of(
    before: Predictive, after: Predictive, scale: float, *, unseen: bool = True
) -> tuple[float, float]:
    """Gain in log score of what was not fitted (of all where there is no such, or unseen is not set), and its
    standard error; scale: mean square of what even the best model leaves [noise's], which deflates both."""
    rows = ~before.seen if unseen and (~before.seen).any() else np.ones_like(before.seen)
    gains = (after.log_score - before.log_score)[rows] / scale
    if len(gains) < 2:
        return float(gains.sum()), float("inf")
    return float(gains.sum()), float(np.sqrt(len(gains)) * gains.std(ddof=1))


@dataclass(frozen=True, eq=False)
class Contender:
    """A candidate in the model. solution: its fit under feedback; predictive: there; free: its fit without
    feedback, where one was made; struck: why it is out, else None."""

    scored: Scored
    solution: Solution | None
    predictive: Predictive | None
    struck: str | None = None
    free: Solution | None = None
    free_predictive: Predictive | None = None

    @property
    def effect(self) -> str:
        return self.scored.effect

    @property
    def belief(self) -> Belief:
        return self.solution.belief


def refitted(
    experiment: Experiment,
    problem: Problem,
    before: Solution,
    scored: Scored,
    *,
    accuracy: float = 2e-3,
    criteria: Criteria = CRITERIA,
) -> Contender:
    """A candidate with all numbers free, from where its score puts it, after one Jacobian and its secants;
    struck where it cannot be simulated."""
    best: Solution | None = None
    why = scored.struck
    for start in (scored.start, *scored.others):
        if start is None:
            continue
        try:
            belief = simulable_strength(problem, start, scored.effect, before.belief)
            known = begun(problem, before, belief)
            found = minimise(problem, belief, iterations=1, relative_tolerance=accuracy, known=known)
        except FAILURES as error:
            why = (str(error).splitlines() or [type(error).__name__])[0]
            continue
        if best is None or found.evaluation.cost < best.evaluation.cost:
            best = found
    if best is None:
        return Contender(scored, None, None, struck=why or "nothing to start from")
    return predicted(experiment, problem, Contender(scored, best, None), criteria)


def predicted(experiment: Experiment, problem: Problem, t: Contender, criteria: Criteria) -> Contender:
    """The contender with what it predicts; struck where what was not fitted cannot be simulated."""
    try:
        compared = experiment.compare(t.belief, problem.settings.spacing, jacobian=False, gain=problem.gain)
    except FAILURES as error:
        return replace(t, struck=str(error).splitlines()[0])
    return replace(t, predictive=predictive(compared, criteria))


def simulable_strength(problem: Problem, start: Belief, name: str, before: Belief) -> Belief:
    """The start, its effect weakened until it asks for no much shorter substep than the model without it.

    Raises SimulationError where even a thousandth of it cannot be simulated.
    """
    usual = problem.stable_substep(before)
    for _ in range(10):
        step = problem.stable_substep(start)
        if np.isfinite(step) and step > SHORTEST * usual:
            return start
        start = weakened(start, name)
    raise SimulationError(f"{name}: no strength of it has a stable substep")


# Further Jacobians of a refit that leads.
ONWARD = 2
# Of the substep without the effect: no refit starts with less.
SHORTEST = 0.3


def weakened(belief: Belief, name: str) -> Belief:
    """Half of an effect: its free numbers that are absent at zero."""
    for p in belief.parameters:
        if p.free and p.key.startswith(f"{name}.") and not p.log and p.lower <= 0.5 * p.value <= p.upper:
            belief = belief.with_parameter(p.key, value=0.5 * p.value)
    return belief


def begun(problem: Problem, before: Solution, start: Belief) -> Evaluation | None:
    """The start's evaluation: derivatives by what is new computed there, by the rest those of the model
    without the effect, which under feedback have hardly changed. None where the two do not fit together."""
    known = {p.key: (k, p) for k, p in enumerate(before.belief.free)}
    free, slope = start.free, before.evaluation.jacobian[: before.evaluation.data_rows]
    new = [p.key for p in free if p.key not in known]
    old = [k for k, p in enumerate(free) if p.key in known]
    if not new or not np.any(slope) or any(known[free[k].key][1].log != free[k].log for k in old):
        return None
    place = {p.key: k for k, p in enumerate(free)}
    positions, slopes = {}, {}
    for name, (_, last) in problem.ranges.items():
        prediction = problem.predictors[name].predict(
            start, last=last, keys=new, substep=problem.substep, feedback=problem.feedback(name)
        )
        positions[name] = prediction.position
        slopes[name] = np.zeros((*prediction.position.shape, len(free)))
        slopes[name][..., [place[key] for key in new]] = prediction.jacobian
    evaluation = problem.evaluated(start, positions, slopes)
    if len(slope) != evaluation.data_rows:
        return None
    jacobian = evaluation.jacobian.copy()
    jacobian[: len(slope), old] = slope[:, [known[free[k].key][0] for k in old]]
    if not np.isfinite(jacobian).all():
        raise SimulationError("the derivatives at the start are not finite")
    return replace(evaluation, slopes=jacobian)


def contenders(
    experiment: Experiment,
    spacing: float,
    gain: float,
    before: Solution,
    chosen: Sequence[Scored],
    *,
    criteria: Criteria = CRITERIA,
    report: Callable[[str], None] | None = None,
) -> list[Contender]:
    """All of some candidates refitted, side by side where there are cores: first with one Jacobian each, and
    those that bring at least `Criteria.promising` of what the best one does go on."""

    def work(own: Experiment, scored: Scored) -> Contender:
        return refitted(own, own.problem(spacing).under(gain), before, scored, criteria=criteria)

    def go_on(own: Experiment, t: Contender) -> Contender:
        problem = own.problem(spacing).under(gain)
        try:
            found = minimise(problem, t.belief, iterations=ONWARD, relative_tolerance=2e-3)
        except FAILURES:
            return t
        return predicted(own, problem, replace(t, solution=found), criteria)

    def brings(t: Contender) -> float:
        return 0.0 if t.solution is None else before.evaluation.chi_square - t.solution.evaluation.chi_square

    found = side_by_side(experiment, work, list(chosen))
    most = max((brings(t) for t in found if t.struck is None), default=0.0)
    onward = [k for k, t in enumerate(found) if t.struck is None and brings(t) >= criteria.promising * most]
    for k, t in zip(onward, side_by_side(experiment, go_on, [found[k] for k in onward]), strict=True):
        found[k] = t
    for t in found if report else ():
        what = t.struck or "{:.3f} fitted, {:.3f} unseen".format(*t.predictive.misfit)
        report(f"  {t.scored.label}: {what}")
    return found
