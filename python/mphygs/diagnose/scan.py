"""All candidates of a model under feedback, scored once: what each would take off the misfit.

Smooth effects and faults by exact tangents at their null. Effects that do nothing near their null by trials:
a run with a finite value, whose change of the prediction stands for a tangent. Under feedback the model stays
beside the measurement whatever is missing, so both are what they would be in the right model.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from mphygs.compare.projection import project_out
from mphygs.diagnose.criteria import CRITERIA, Criteria
from mphygs.diagnose.multiplicity import simulate_family
from mphygs.diagnose.places import ways_between
from mphygs.diagnose.power import detectable_strength
from mphygs.diagnose.score import score_candidates
from mphygs.diagnose.score_table import Candidate, Score, ScoreTable
from mphygs.diagnose.spots import Spot, Spots
from mphygs.diagnose.starts import other_starts, start_of
from mphygs.diagnose.ties import tied_with
from mphygs.diagnose.trials import Trial
from mphygs.diagnose.ways import Way
from mphygs.fit.experiment import Experiment
from mphygs.fit.problem import Evaluation, Problem
from mphygs.fit.side_by_side import side_by_side
from mphygs.model.belief import Belief
from mphygs.model.registry import effect
from mphygs.simulate.errors import FAILURES, SimulationError

# Of tests, all candidates together.
LEVEL = 0.01
# Trials of an effect that promise this share of the best one's drop are starts of its refit as well; so many.
ALSO, OTHERS = 0.5, 2


@dataclass(frozen=True, eq=False)
class Scored:
    """One way of an effect. drop: of chi^2 that it promises; numbers: that it costs, scanned ones included;
    tangent: (N, q) what it does to the prediction, whitened, by numbers called labels, None of a trial;
    start: the belief that a refit begins with, others: further ones; struck: why it is out, else None; alike:
    effects that the score does not tell from it; detectable: smallest size of each number that would have
    been found."""

    effect: str
    label: str
    kind: str
    drop: float
    numbers: int
    p_value: float
    estimate: dict[str, float]
    std: dict[str, float]
    start: Belief | None
    tangent: np.ndarray | None = field(repr=False, default=None)
    others: tuple[Belief, ...] = ()
    struck: str | None = None
    alike: tuple[str, ...] = ()
    detectable: dict[str, float] = field(default_factory=dict)
    labels: tuple[str, ...] = ()

    def worth(self, price: float, scale: float) -> float:
        """Drop less the price of its numbers, in units of the noise that is left."""
        return self.drop / scale - price * self.numbers


@dataclass(frozen=True, eq=False)
class Scan:
    """scored: every way, the best first; chi_square, rows: of the fitted frames; scale: mean square that the
    best of all leaves, at least 1; price: of a number, in units of `scale`; spots: what is left of the fit,
    by block; drift: fitted numbers that would have to change for a while; table: of the smooth ways."""

    scored: tuple[Scored, ...]
    chi_square: float
    rows: int
    scale: float
    price: float
    spots: Spots
    drift: tuple[Spot, ...]
    table: ScoreTable | None

    def by_effect(self) -> list[Scored]:
        """The best way of every effect, the best effect first."""
        best: dict[str, Scored] = {}
        for s in self.scored:
            best.setdefault(s.effect, s)
        return list(best.values())


def scan(
    experiment: Experiment,
    problem: Problem,
    belief: Belief,
    evaluation: Evaluation,
    ways: Sequence[Way],
    trials: Sequence[Trial] = (),
    *,
    generator: np.random.Generator,
    criteria: Criteria = CRITERIA,
    report: Callable[[str], None] | None = None,
) -> Scan:
    """Score all ways and trials beside a fitted model.

    problem: the fit, under feedback; evaluation: of the belief there, with Jacobian.
    """
    rows = evaluation.data_rows
    residual = evaluation.residual[:rows]
    # Priors stay as rows: what they forbid cannot absorb an effect.
    prior = -evaluation.jacobian[rows:]
    prior = prior[np.abs(prior).sum(1) > 0]
    full_residual = np.r_[residual, np.zeros(len(prior))]
    full_jacobian = np.vstack([-evaluation.jacobian[:rows], prior])
    projection = project_out(full_jacobian)

    def padded(columns: np.ndarray) -> np.ndarray:
        return np.vstack([columns, np.zeros((len(prior), columns.shape[1]))])

    tangents, failed = _tangents(experiment, problem, belief, ways, report)
    if ways and all(columns is not None for columns in tangents):
        body = next(iter(problem.predictors.values())).body
        flat = padded(np.hstack(tangents))
        between = ways_between(belief, body, ways, flat, full_residual, full_jacobian)
        if between:
            ways = [*ways, *between]
            tangents = [*tangents, *_tangents(experiment, problem, belief, between, None)[0]]
    scored: list[Scored] = []
    candidates, smooth = [], []
    for way, columns in zip(ways, tangents, strict=True):
        if columns is None:
            scored.append(_lost(way.effect, way.label, failed.get(way.label, "its tangents are not finite")))
            continue
        smooth.append(way)
        null = np.zeros(columns.shape[1])
        candidates.append(
            Candidate(name=way.label, tangent=padded(columns), lower_bounded=way.bounded, null=null)
        )
    table = None
    if candidates:
        table = score_candidates(full_residual, full_jacobian, candidates, generator=generator)
        family = None
        if any(score.testable for score in table.scores):
            family = simulate_family(table, generator=generator)
        names = {way.label: way.effect for way in smooth}
        for way, score, candidate in zip(smooth, table.scores, candidates, strict=True):
            one = _of_score(way, score, belief, candidate.tangent, len(table.scores))
            if one.struck is None:
                tied = tuple(sorted({names[t.rival] for t in tied_with(table, way.label)} - {way.effect}))
                one = replace(one, p_value=float(family.p_value(score)), alike=tied)
            scored.append(one)
    scored += _tried(experiment, problem, evaluation, trials, projection, full_residual, len(prior), report)
    chi_square = float(residual @ residual)
    best = max((s.drop for s in scored if s.struck is None), default=0.0)
    scale = max((chi_square - best) / max(rows, 1), 1.0)
    price = criteria.price * float(np.log(max(rows / scale, 2.0)))
    scored.sort(key=lambda s: -s.worth(price, scale) if s.struck is None else np.inf)
    spots = Spots.of(experiment, problem, full_residual, full_jacobian)
    drift = spots.of_columns(full_jacobian, [p.key for p in belief.free])
    return Scan(tuple(scored), chi_square, rows, scale, price, spots, drift, table)


def _lost(effect_name: str, label: str, why: str) -> Scored:
    kind = effect(effect_name).kind
    return Scored(effect_name, label, kind, 0.0, 0, 1.0, {}, {}, None, struck=why)


def _of_score(way: Way, score: Score, belief: Belief, tangent: np.ndarray, family: int) -> Scored:
    kind = effect(way.effect).kind
    public = labels = [p.key.rsplit(".", 1)[1] for _, p in way.columns]
    if len(set(labels)) < len(labels):
        labels = [f"{label}_{k}" for k, label in enumerate(labels)]
    scanned = len(way.values) + 3 * ("place" in way.settings)
    numbers = len(labels) + scanned
    if not score.testable:
        return Scored(way.effect, way.label, kind, 0.0, numbers, 1.0, {}, {}, None, struck=score.reason)
    nulls = np.array([p.value for _, p in way.columns]) if effect(way.effect).replaces else 0.0
    estimate = score.estimate + nulls
    return Scored(
        way.effect,
        way.label,
        kind,
        float(score.drop),
        numbers,
        float(score.p_value),
        dict(zip(labels, map(float, estimate), strict=True)),
        dict(zip(labels, map(float, score.std), strict=True)),
        start_of(way, estimate, belief),
        tangent,
        other_starts(way, score, belief),
        detectable=_detectable(public, score, family),
        labels=tuple(public),
    )


def _detectable(parameters: Sequence[str], score: Score, family: int) -> dict[str, float]:
    """Smallest size of each parameter that would have been found among so many candidates, where any
    would."""
    sizes: dict[str, float] = {}
    for parameter, size in zip(
        parameters, detectable_strength(score, level=LEVEL, family=family), strict=True
    ):
        sizes[parameter] = max(float(size), sizes.get(parameter, 0.0))
    return {parameter: size for parameter, size in sizes.items() if np.isfinite(size)}


def _tangents(
    experiment: Experiment,
    problem: Problem,
    belief: Belief,
    ways: Sequence[Way],
    report: Callable[[str], None] | None,
) -> tuple[list[np.ndarray | None], dict[str, str]]:
    """Whitened columns (N, q) of every way, None where they cannot be had, and why, by label.

    All in as few runs as there can be; effect by effect where one of them spoils these.
    """
    if not ways:
        return [], {}
    if report:
        report(f"tangents of {sum(len(way.columns) for way in ways)} candidate numbers")
    try:
        return _of_ways(experiment, problem, belief, ways), {}
    except FAILURES:
        pass
    found: dict[str, np.ndarray | None] = {}
    why: dict[str, str] = {}
    for name in dict.fromkeys(way.effect for way in ways):
        own = [way for way in ways if way.effect == name]
        try:
            columns = _of_ways(experiment, problem, belief, own)
        except FAILURES as error:
            columns = [None] * len(own)
            reason = (str(error).splitlines() or [type(error).__name__])[0]
            why |= {way.label: reason for way in own}
        found |= {way.label: c for way, c in zip(own, columns, strict=True)}
    return [found[way.label] for way in ways], why


def _of_ways(
    experiment: Experiment, problem: Problem, belief: Belief, ways: Sequence[Way]
) -> list[np.ndarray | None]:
    """Whitened columns of some ways; None for those that are not finite. Raises what a run raises."""
    columns = [pair for way in ways for pair in way.columns]
    slopes = np.array([p.slope for _, p in columns])
    blocks = []
    for name, (first, last) in problem.ranges.items():
        prediction = problem.predictors[name].predict(
            belief,
            last=last,
            candidates=columns,
            substep=problem.substep,
            feedback=problem.feedback(name),
        )
        if not np.isfinite(prediction.position).all():
            raise SimulationError("the motion is not finite beside its null")
        raw = prediction.jacobian[first:last] / slopes
        finite = np.isfinite(raw).all((0, 1, 2))
        raw[..., ~finite] = 0.0
        white = experiment.observations[name].whitener(first, last).whiten(raw)
        white[:, ~finite] = np.nan
        blocks.append(white)
    together = np.concatenate(blocks)
    ends = np.cumsum([len(way.columns) for way in ways])
    pieces = np.split(together, ends[:-1], axis=1)
    return [own if np.isfinite(own).all() else None for own in pieces]


def _tried(
    experiment: Experiment,
    problem: Problem,
    evaluation: Evaluation,
    trials: Sequence[Trial],
    projection: object,
    residual: np.ndarray,
    priors: int,
    report: Callable[[str], None] | None,
) -> list[Scored]:
    """Every trial by a run with it."""
    spacing, gain, ranges = problem.settings.spacing, problem.gain, problem.ranges

    def run(own: Experiment, trial: Trial) -> Evaluation | str:
        try:
            there = own.problem(spacing).with_ranges(ranges).under(gain)
            return there.evaluate(trial.belief, jacobian=False)
        except FAILURES as error:
            return (str(error).splitlines() or [type(error).__name__])[0]

    if trials and report:
        report(f"{len(trials)} trials of effects without a derivative at their null")
    found = []
    rows = evaluation.data_rows
    for trial, moved in zip(trials, side_by_side(experiment, run, list(trials)), strict=True):
        if isinstance(moved, str):
            found.append(_lost(trial.effect, trial.label, moved))
            continue
        change = np.r_[evaluation.residual[:rows] - moved.residual[:rows], np.zeros(priors)]
        left = projection.remaining(change)
        # Of what such a change explains at the amount that fits best: levels are far apart.
        along, power = float(left @ residual), float(left @ left)
        drop = max(along, 0.0) ** 2 / power if power > 1e-9 else 0.0
        estimate = {
            p.key.rsplit(".", 1)[1]: p.value
            for p in trial.belief.parameters
            if p.key.startswith(f"{trial.effect}.") and p.free
        }
        found.append(
            Scored(
                trial.effect,
                trial.label,
                effect(trial.effect).kind,
                drop,
                len(estimate),
                float("nan"),
                estimate,
                {},
                trial.belief,
            )
        )
    # From the best trial of an effect no way may lead to the others that promise nearly as much: a refit
    # begins with each of them.
    out = []
    for s in found:
        own = sorted((t for t in found if t.effect == s.effect and t.struck is None), key=lambda t: -t.drop)
        others = tuple(t.start for t in own if t is not s and t.drop > ALSO * s.drop)[:OTHERS]
        out.append(replace(s, others=others) if s.struck is None else s)
    return out
