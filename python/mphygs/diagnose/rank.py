"""Rank what could explain a fitted model's misfit: smooth effects and faults by score, others by trial."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from mphygs.compare.allowance import Allowance
from mphygs.diagnose.decoys import DecoyCheck, check_decoys
from mphygs.diagnose.effect_variants import LATE, EffectVariant, late_variants, smooth_variants
from mphygs.diagnose.interpolated_places import variants_between
from mphygs.diagnose.local_scores import Spots
from mphygs.diagnose.multiplicity import simulate_family
from mphygs.diagnose.periodic_variants import periodic_variants
from mphygs.diagnose.power import detectable_strength
from mphygs.diagnose.ranking import LEVEL, RankedEffect, Ranking
from mphygs.diagnose.refit_starts import other_starts, refit_start
from mphygs.diagnose.score import score_candidates
from mphygs.diagnose.score_table import Candidate, Score, ScoreTable
from mphygs.diagnose.stacked_tangents import simulable_variants, stacked_tangents
from mphygs.diagnose.ties import tied_with
from mphygs.diagnose.trial_ranking import rank_by_trials
from mphygs.fit.experiment import Experiment
from mphygs.fit.placement import masses_of_loads
from mphygs.fit.problem import Evaluation, Problem
from mphygs.model.belief import Belief
from mphygs.model.registry import effect
from mphygs.simulate.errors import SimulationError

# Of the fitted frames, the first, in which what came after the shape was taken is to be seen; and a misfit
# there that is more than noise [sigma].
EARLY, EARLY_MISFIT = 0.16, 1.25
# A trial of a smooth effect stands for it where its drop of chi^2 is this share of what tangents promise:
# far from the data they promise much.
TRIAL_WINS = 0.2
# Of what a late mass promises at the best place: so many next best ones that promise as much are begun from.
NEARLY_AS_MUCH, ELSEWHERE = 0.8, 4


def _off_at_the_start(experiment: Experiment, problem: Problem, evaluation: Evaluation) -> bool:
    """Whether the first frames are off by more than noise: so they are where a load came after the published
    shape was taken."""
    square, count = 0.0, 0
    for name, (first, last) in problem.ranges.items():
        whole = experiment.fitted[name][1]
        rows = evaluation.residual[evaluation.rows[name]]
        early = first + experiment.observations[name].whitener(first, last).frame < EARLY * whole
        square, count = square + float(rows[early] @ rows[early]), count + int(early.sum())
    return square > EARLY_MISFIT**2 * max(count, 1)


def rank(
    experiment: Experiment,
    belief: Belief,
    evaluation: Evaluation,
    spacing: float,
    *,
    share: float = 1.0,
    generator: np.random.Generator,
    names: Sequence[str] | None = None,
    allowance: Allowance | None = None,
    trials: bool = True,
    report: Callable[[str], None] | None = None,
) -> Ranking:
    """Rank all effects and faults that the model does not have.

    evaluation: of the fit at `belief` and `spacing` to the first `share` of the frames, with Jacobian.
    names: effects to consider (None: all); trials: whether thresholds and the like are tried too.
    """
    problem = experiment.window(spacing, share)
    rows = evaluation.data_rows
    residual = evaluation.residual[:rows]  # measured - predicted
    jacobian = -evaluation.jacobian[:rows]
    # Priors stay as rows: what they forbid cannot absorb an effect.
    prior = -evaluation.jacobian[rows:]
    prior = prior[np.abs(prior).sum(1) > 0]
    full_residual = np.r_[residual, np.zeros(len(prior))]
    full_jacobian = np.vstack([jacobian, prior])
    body = next(iter(problem.predictors.values())).body
    hung = masses_of_loads(experiment.capture, list(problem.ranges))
    variants = smooth_variants(belief, body, names=names, hung=hung)
    worst = evaluation.worst
    first, last = problem.ranges[worst]
    misfit = experiment.observations[worst].position[first:last] - evaluation.positions[worst][first:last]
    fps = experiment.capture.sequence(worst).fps
    variants += periodic_variants(belief, body.transfer, misfit, fps, first / fps, names=names)
    if _off_at_the_start(experiment, problem, evaluation):
        variants += late_variants(belief, body, names=names)
    # Decoys draw numbers of their own: the rest is the same with and without them.
    draw, struck = generator.spawn(1)[0], []
    try:
        tangents, fakes = stacked_tangents(experiment, problem, belief, variants, report, draw)
    except SimulationError:
        variants, struck = simulable_variants(
            experiment, problem, belief, variants, evaluation.misfit, report
        )
        tangents, fakes = stacked_tangents(experiment, problem, belief, variants, report, draw)
    tangents = np.vstack([tangents, np.zeros((len(prior), tangents.shape[1]))])
    between = variants_between(belief, body, variants, tangents, full_residual, full_jacobian)
    if between:
        more, _ = stacked_tangents(experiment, problem, belief, between, None, np.random.default_rng(0))
        variants = [*variants, *between]
        tangents = np.hstack([tangents, np.vstack([more, np.zeros((len(prior), more.shape[1]))])])
    candidates, at = [], 0
    for variant in variants:
        count = len(variant.columns)
        columns = tangents[:, at : at + count]
        candidates.append(
            Candidate(
                name=variant.label, tangent=columns, lower_bounded=variant.bounded, null=np.zeros(count)
            )
        )
        at += count
    known = allowance or Allowance()
    if known.directions is not None:
        missing = len(full_residual) - len(known.directions)
        padded = np.vstack([known.directions, np.zeros((missing, known.directions.shape[1]))])
        known = Allowance(directions=padded)
    table = score_candidates(full_residual, full_jacobian, candidates, generator=generator, allowance=known)
    # Where only thresholds are asked for, or nothing smooth can be told, there is no family.
    testable = any(score.testable for score in table.scores)
    family = simulate_family(table, generator=generator) if testable else None
    decoys, decoy_statistic = _decoys(full_residual, full_jacobian, fakes, known, generator.spawn(1)[0])
    spots = Spots.of(experiment, problem, full_residual, full_jacobian, known)
    best: dict[str, tuple[EffectVariant, Score]] = {}
    tangent_of = {
        variant.label: candidate.tangent for variant, candidate in zip(variants, candidates, strict=True)
    }
    for variant, score in zip(variants, table.scores, strict=True):
        worth = score.drop - 2 * score.parameter_count if score.testable else -np.inf
        old = best.get(variant.effect)
        if old is None or worth > (old[1].drop - 2 * old[1].parameter_count if old[1].testable else -np.inf):
            best[variant.effect] = (variant, score)
    names_of = {variant.label: variant.effect for variant in variants}
    entries = struck
    for name, (variant, score) in best.items():
        entry = _entry(name, variant, score, table, family, names_of, belief, rows)
        if "place" in variant.settings and not variant.form and LATE.items() <= variant.settings.items():
            entry = replace(entry, others=_next_best_starts(variant, score, variants, table, belief))
        if score.testable:
            parameters = [p.key.rsplit(".", 1)[1] for _, p in variant.columns]
            entry = replace(entry, spots=spots.of_columns(tangent_of[variant.label], parameters))
        entries.append(replace(entry, stands_out=decoys.stands_out(score) if decoys else None))
    if trials:
        tried = rank_by_trials(
            experiment, belief, evaluation, problem, share, full_residual, full_jacobian, generator, names,
            report,
        )  # fmt: skip
        entries = _with_trials(entries, tried)
    entries.sort(key=lambda e: -(e.statistic - 2 * len(e.estimate)))
    chi_square = float(residual @ residual)
    drift = spots.of_columns(full_jacobian, [p.key for p in belief.free])
    return Ranking(tuple(entries), chi_square, rows, table, decoys, decoy_statistic, drift)


def _next_best_starts(
    best: EffectVariant, score: Score, variants: Sequence[EffectVariant], table: ScoreTable, belief: Belief
) -> tuple[Belief, ...]:
    """Starts of an effect in its next best variants that promise nearly as much as the best one."""
    rest = [
        (other.drop, variant, other)
        for variant, other in zip(variants, table.scores, strict=True)
        if variant is not best
        and variant.effect == best.effect
        and variant.settings.keys() == best.settings.keys()
    ]
    near = sorted((item for item in rest if item[0] > NEARLY_AS_MUCH * score.drop), key=lambda item: -item[0])
    return tuple(refit_start(variant, other.estimate, belief) for _, variant, other in near[:ELSEWHERE])


def _with_trials(entries: Sequence[RankedEffect], trials: Sequence[RankedEffect]) -> list[RankedEffect]:
    """One entry for every effect: its trial where that holds its own against what its tangents promise."""
    tried = {entry.effect: entry for entry in trials}
    kept = []
    for entry in entries:
        trial = tried.get(entry.effect)
        if trial is None:
            kept.append(entry)
        elif trial.statistic < TRIAL_WINS * entry.statistic:
            kept.append(entry)
            del tried[entry.effect]
    return kept + list(tried.values())


def _decoys(
    residual: np.ndarray,
    jacobian: np.ndarray,
    fakes: np.ndarray,
    allowance: Allowance,
    generator: np.random.Generator,
) -> tuple[DecoyCheck | None, float]:
    """How effects that do nothing score; none where the fitted parameters absorb all of them."""
    padded = np.vstack([fakes, np.zeros((len(residual) - len(fakes), fakes.shape[1]))])
    free, null = np.zeros(1, bool), np.zeros(1)
    candidates = [
        Candidate(name=f"decoy {k}", tangent=padded[:, [k]], lower_bounded=free, null=null)
        for k in range(padded.shape[1])
    ]
    table = score_candidates(residual, jacobian, candidates, generator=generator, allowance=allowance)
    if not any(score.testable for score in table.scores):
        return None, 0.0
    return check_decoys(table, generator=generator), float(max(score.drop for score in table.scores))


def _entry(
    name: str,
    variant: EffectVariant,
    score: Score,
    table: ScoreTable,
    family: object,
    names_of: dict[str, str],
    belief: Belief,
    rows: int,
) -> RankedEffect:
    # What takes the place of something else is estimated from there.
    replaces = effect(name).replaces
    null = np.array([p.value if replaces else 0.0 for _, p in variant.columns])
    public = labels = [p.key.rsplit(".", 1)[1] for _, p in variant.columns]
    if len(set(labels)) < len(labels):
        labels = [f"{label}_{k}" for k, label in enumerate(labels)]
    estimate = score.estimate + null
    kind = effect(name).kind
    if not score.testable:
        return RankedEffect(
            name,
            variant.label,
            kind,
            0.0,
            1.0,
            float(np.sqrt(table.chi_square / rows)),
            {},
            {},
            belief,
            reason=score.reason,
        )
    tied = {names_of[t.rival] for t in tied_with(table, variant.label)} - {name}
    return RankedEffect(
        name,
        variant.label,
        kind,
        float(score.drop),
        float(family.p_value(score)),
        float(np.sqrt(max(score.expected_chi_square, 0.0) / rows)),
        dict(zip(labels, map(float, estimate), strict=True)),
        dict(zip(labels, map(float, score.std), strict=True)),
        refit_start(variant, estimate, belief),
        tuple(sorted(tied)),
        detectable=_detectable(variant, public, score, len(table.scores)),
        others=other_starts(variant, score, belief),
    )


def _detectable(
    variant: EffectVariant, parameters: Sequence[str], score: Score, family: int
) -> dict[str, float]:
    """Smallest size of each parameter that would have been found among so many candidates, where any would.

    Of one that has several columns (a sine and a cosine, axes of a slope) in whichever of them it is; of what
    is tied to an anchor the stiffness, its other columns are pulls.
    """
    strengths: dict[str, float] = {}
    sizes = detectable_strength(score, level=LEVEL, family=family)
    for parameter, size in zip(parameters, sizes, strict=True):
        if variant.form != "anchor" or parameter not in strengths:
            strengths[parameter] = max(float(size), strengths.get(parameter, 0.0))
    return {parameter: size for parameter, size in strengths.items() if np.isfinite(size)}
