"""Rank what could explain a fitted model's misfit: smooth effects and faults by score, others by trial."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from mphygs.compare.allowance import Allowance
from mphygs.diagnose.decoys import DecoyCheck, check_decoys, decoy_tangents
from mphygs.diagnose.multiplicity import simulate_family
from mphygs.diagnose.places import ways_between
from mphygs.diagnose.power import detectable_strength
from mphygs.diagnose.ranking import LEVEL, Entry, Ranking, lost
from mphygs.diagnose.score import score_candidates
from mphygs.diagnose.score_table import Candidate, Score, ScoreTable
from mphygs.diagnose.shaking import shaking_ways
from mphygs.diagnose.spots import Spots
from mphygs.diagnose.starts import other_starts, start_of
from mphygs.diagnose.ties import tied_with
from mphygs.diagnose.tried import tried_effects
from mphygs.diagnose.ways import LATE, Way, late_ways, smooth_ways
from mphygs.fit.experiment import Experiment
from mphygs.fit.placement import masses_of_loads
from mphygs.fit.problem import Evaluation, Problem
from mphygs.model.belief import Belief
from mphygs.model.registry import effect
from mphygs.simulate.errors import SimulationError

# Effects that do nothing, scored beside the candidates.
DECOYS = 20
# Of the fitted frames, the first, in which what came after the shape was taken is to be seen; and a misfit
# there that is more than noise [sigma].
EARLY, EARLY_MISFIT = 0.16, 1.25
# A trial of a smooth effect stands for it where its drop of chi^2 is this share of what tangents promise:
# far from the data they promise much.
TRIAL_WINS = 0.2
# Of what a late mass promises at the best place: so many next best ones that promise as much are begun from.
NEARLY_AS_MUCH, ELSEWHERE = 0.8, 4


def _stack(
    experiment: Experiment,
    problem: Problem,
    belief: Belief,
    ways: Sequence[Way],
    report: Callable[[str], None] | None,
    generator: np.random.Generator,
) -> tuple[np.ndarray, np.ndarray]:
    """Whitened Jacobian columns of all ways over the fitted frames, (N, Q), in the order of the ways, and of
    decoys that are as smooth, (N, DECOYS)."""
    columns = [pair for way in ways for pair in way.columns]
    blocks, decoys, sensors = [], [], []
    for name, (first, last) in problem.ranges.items():
        if report:
            report(f"tangents of {len(columns)} candidate parameters on {name}")
        prediction = problem.predictors[name].predict(belief, last=last, candidates=columns)
        whitener = experiment.observations[name].whitener(first, last)
        # Coordinates are values over scales: back to units of the parameter.
        slopes = np.array([p.slope for _, p in columns])
        raw = prediction.jacobian[first:last]
        blocks.append(whitener.whiten(raw) / slopes)
        if np.any(raw):
            decoys.append(whitener.whiten(decoy_tangents(raw, DECOYS, generator=generator)))
        else:
            decoys.append(np.zeros((len(blocks[-1]), DECOYS)))
        for sensor, reading in zip(experiment.observations[name].sensors, prediction.readings, strict=True):
            sensors.append(sensor.whitener(first, last).whiten(reading.jacobian[first:last]) / slopes)
    # Decoys move markers alone.
    decoys += [np.zeros((len(block), DECOYS)) for block in sensors]
    return np.concatenate([*blocks, *sensors]), np.concatenate(decoys)


def _simulable(
    experiment: Experiment,
    problem: Problem,
    belief: Belief,
    ways: Sequence[Way],
    misfit: float,
    report: Callable[[str], None] | None,
) -> tuple[list[Way], list[Entry]]:
    """The ways of those effects that can be simulated beside the model at their null, and the others, each
    with the reason. misfit: of the model [sigma]. Raises SimulationError where there is none."""
    failed: dict[str, SimulationError] = {}
    for name in dict.fromkeys(way.effect for way in ways):
        own = [way for way in ways if way.effect == name]
        try:
            _stack(experiment, problem, belief, own, None, np.random.default_rng(0))
        except SimulationError as error:
            failed[name] = error
            if report:
                report(f"{name} is left out, for it cannot be simulated: {error}")
    left = [way for way in ways if way.effect not in failed]
    if not left and failed:
        raise next(iter(failed.values()))
    struck = [lost(name, name, str(error), belief, misfit) for name, error in failed.items()]
    return left, struck


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
    ways = smooth_ways(belief, body, names=names, hung=hung)
    worst = evaluation.worst
    first, last = problem.ranges[worst]
    misfit = experiment.observations[worst].position[first:last] - evaluation.positions[worst][first:last]
    fps = experiment.capture.sequence(worst).fps
    ways += shaking_ways(belief, body.transfer, misfit, fps, first / fps, names=names)
    if _off_at_the_start(experiment, problem, evaluation):
        ways += late_ways(belief, body, names=names)
    # Decoys draw numbers of their own: the rest is the same with and without them.
    draw, struck = generator.spawn(1)[0], []
    try:
        tangents, fakes = _stack(experiment, problem, belief, ways, report, draw)
    except SimulationError:
        ways, struck = _simulable(experiment, problem, belief, ways, evaluation.misfit, report)
        tangents, fakes = _stack(experiment, problem, belief, ways, report, draw)
    tangents = np.vstack([tangents, np.zeros((len(prior), tangents.shape[1]))])
    between = ways_between(belief, body, ways, tangents, full_residual, full_jacobian)
    if between:
        more, _ = _stack(experiment, problem, belief, between, None, np.random.default_rng(0))
        ways = [*ways, *between]
        tangents = np.hstack([tangents, np.vstack([more, np.zeros((len(prior), more.shape[1]))])])
    candidates, at = [], 0
    for way in ways:
        count = len(way.columns)
        columns = tangents[:, at : at + count]
        candidates.append(
            Candidate(name=way.label, tangent=columns, lower_bounded=way.bounded, null=np.zeros(count))
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
    best: dict[str, tuple[Way, Score]] = {}
    tangent_of = {way.label: candidate.tangent for way, candidate in zip(ways, candidates, strict=True)}
    for way, score in zip(ways, table.scores, strict=True):
        worth = score.drop - 2 * score.parameter_count if score.testable else -np.inf
        old = best.get(way.effect)
        if old is None or worth > (old[1].drop - 2 * old[1].parameter_count if old[1].testable else -np.inf):
            best[way.effect] = (way, score)
    names_of = {way.label: way.effect for way in ways}
    entries = struck
    for name, (way, score) in best.items():
        entry = _entry(name, way, score, table, family, names_of, belief, rows)
        if "place" in way.settings and not way.form and LATE.items() <= way.settings.items():
            entry = replace(entry, others=_elsewhere(way, score, ways, table, belief))
        if score.testable:
            parameters = [p.key.rsplit(".", 1)[1] for _, p in way.columns]
            entry = replace(entry, spots=spots.of_columns(tangent_of[way.label], parameters))
        entries.append(replace(entry, stands_out=decoys.stands_out(score) if decoys else None))
    if trials:
        tried = tried_effects(
            experiment, belief, evaluation, problem, share, full_residual, full_jacobian, generator, names,
            report,
        )  # fmt: skip
        entries = _with_trials(entries, tried)
    entries.sort(key=lambda e: -(e.statistic - 2 * len(e.estimate)))
    chi_square = float(residual @ residual)
    drift = spots.of_columns(full_jacobian, [p.key for p in belief.free])
    return Ranking(tuple(entries), chi_square, rows, table, decoys, decoy_statistic, drift)


def _elsewhere(
    best: Way, score: Score, ways: Sequence[Way], table: ScoreTable, belief: Belief
) -> tuple[Belief, ...]:
    """Starts of an effect in its next best ways that promise nearly as much as the best one."""
    rest = [
        (other.drop, way, other)
        for way, other in zip(ways, table.scores, strict=True)
        if way is not best and way.effect == best.effect and way.settings.keys() == best.settings.keys()
    ]
    near = sorted((item for item in rest if item[0] > NEARLY_AS_MUCH * score.drop), key=lambda item: -item[0])
    return tuple(start_of(way, other.estimate, belief) for _, way, other in near[:ELSEWHERE])


def _with_trials(entries: Sequence[Entry], trials: Sequence[Entry]) -> list[Entry]:
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
    way: Way,
    score: Score,
    table: ScoreTable,
    family: object,
    names_of: dict[str, str],
    belief: Belief,
    rows: int,
) -> Entry:
    # What takes the place of something else is estimated from there.
    replaces = effect(name).replaces
    null = np.array([p.value if replaces else 0.0 for _, p in way.columns])
    public = labels = [p.key.rsplit(".", 1)[1] for _, p in way.columns]
    if len(set(labels)) < len(labels):
        labels = [f"{label}_{k}" for k, label in enumerate(labels)]
    estimate = score.estimate + null
    kind = effect(name).kind
    if not score.testable:
        return Entry(
            name,
            way.label,
            kind,
            0.0,
            1.0,
            float(np.sqrt(table.chi_square / rows)),
            {},
            {},
            belief,
            reason=score.reason,
        )
    tied = {names_of[t.rival] for t in tied_with(table, way.label)} - {name}
    return Entry(
        name,
        way.label,
        kind,
        float(score.drop),
        float(family.p_value(score)),
        float(np.sqrt(max(score.expected_chi_square, 0.0) / rows)),
        dict(zip(labels, map(float, estimate), strict=True)),
        dict(zip(labels, map(float, score.std), strict=True)),
        start_of(way, estimate, belief),
        tuple(sorted(tied)),
        detectable=_detectable(way, public, score, len(table.scores)),
        others=other_starts(way, score, belief),
    )


def _detectable(way: Way, parameters: Sequence[str], score: Score, family: int) -> dict[str, float]:
    """Smallest size of each parameter that would have been found among so many candidates, where any would.

    Of one that has several columns (a sine and a cosine, axes of a slope) in whichever of them it is; of what
    is tied to an anchor the stiffness, its other columns are pulls.
    """
    strengths: dict[str, float] = {}
    sizes = detectable_strength(score, level=LEVEL, family=family)
    for parameter, size in zip(parameters, sizes, strict=True):
        if way.form != "anchor" or parameter not in strengths:
            strengths[parameter] = max(float(size), strengths.get(parameter, 0.0))
    return {parameter: size for parameter, size in strengths.items() if np.isfinite(size)}
