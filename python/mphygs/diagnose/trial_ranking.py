"""Effects whose tangents say nothing, ranked by runs with a few of their sizes or places."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from mphygs.diagnose.contact_search import walls
from mphygs.diagnose.effect_variants import absent_effects, strengths
from mphygs.diagnose.finite_trials import Trial, trials_of
from mphygs.diagnose.ranking import RankedEffect, unsimulated
from mphygs.diagnose.thresholds import onset_levels
from mphygs.diagnose.trial_scores import TrialScores, score_trials
from mphygs.diagnose.wall import with_wall
from mphygs.fit.experiment import Experiment
from mphygs.fit.problem import Evaluation, Problem
from mphygs.fit.side_by_side import side_by_side
from mphygs.model.belief import Belief
from mphygs.model.descriptor import EffectSpec
from mphygs.model.registry import effect
from mphygs.simulate.errors import SimulationError

# Of the sum of squares: what changes less of a motion than this is not told from noise.
TELLS = 16.0


def rank_by_trials(
    experiment: Experiment,
    belief: Belief,
    evaluation: Evaluation,
    problem: Problem,
    share: float,
    residual: np.ndarray,
    jacobian: np.ndarray,
    generator: np.random.Generator,
    names: Sequence[str] | None,
    report: Callable[[str], None] | None,
) -> list[RankedEffect]:
    """Threshold effects, soft holds, masses of known loads, laws: the best of a few finite trials each, with
    the p-value of the best of so many. What is tried is read off the sequence that is off most."""
    name = evaluation.worst
    problem = problem.with_ranges({name: problem.ranges[name], **problem.ranges})
    observation = experiment.observations[name]
    groups: dict[str, list[Trial]] = {}
    for spec in absent_effects(belief, problem.settings.transfer, names):
        if spec.of_role("offset"):
            found = walls(
                problem, observation, belief, evaluation, spec,
                share=share, workers=experiment.settings.workers, report=report,
            )  # fmt: skip
            groups[spec.name] = [Trial(spec.name, p.label, with_wall(own, spec, p)) for own, p in found]
        else:
            groups[spec.name] = trials_of(spec, experiment.capture, problem, belief, evaluation)

    def tried(twin: Experiment, trial: Trial) -> Evaluation | str:
        try:
            return twin.window(problem.settings.spacing, share).evaluate(trial.belief, jacobian=False)
        except SimulationError as error:
            return str(error)

    entries = []
    for kind, trials in groups.items():
        if report:
            for trial in trials:
                report(f"trial: {trial.effect}, {trial.label}")
        changes, kept, why = [], [], ""
        for trial, moved in zip(trials, side_by_side(experiment, tried, trials), strict=True):
            if isinstance(moved, str):
                why = why or moved
            else:
                changes.append(
                    evaluation.residual[: evaluation.data_rows] - moved.residual[: evaluation.data_rows]
                )
                kept.append(trial)
        if not kept:
            if trials:
                entries.append(unsimulated(kind, trials[0].label, why, belief, evaluation.misfit))
            continue
        matrix = np.vstack(
            [np.stack(changes, axis=1), np.zeros((len(residual) - len(changes[0]), len(kept)))]
        )
        scores = score_trials(residual, jacobian, matrix, generator=generator)
        trial = kept[scores.best]
        if not effect(kind).fitted and scores.powers[scores.best] < TELLS:
            # There is no more of it than that.
            why = "differs by less than noise can tell, beside numbers that are fitted"
            entries.append(unsimulated(kind, trial.label, why, belief, evaluation.misfit))
            continue
        estimate = {
            p.key.rsplit(".", 1)[1]: p.value
            for p in trial.belief.parameters
            if p.key.startswith(f"{kind}.") and p.free
        }
        rows = evaluation.data_rows
        expected = max(float(residual @ residual) - scores.drop, 0.0)
        entries.append(
            RankedEffect(
                kind,
                trial.label,
                effect(kind).kind,
                float(scores.drop),
                float(scores.p_value),
                float(np.sqrt(expected / rows)),
                estimate,
                {},
                trial.belief,
                others=_others(effect(kind), trial, kept, scores, belief),
            )
        )
    return entries


def _others(
    spec: EffectSpec, best: Trial, trials: Sequence[Trial], scores: TrialScores, belief: Belief
) -> tuple[Belief, ...]:
    """Further starts of a refit. Trials of a wall are places, those of other effects sizes: no way leads from
    one to another. Beside a level with a strength the materials are where the effect leaves them, at each
    level: held where they are without it, they leave none of it."""
    if spec.of_role("offset"):
        return tuple(t.belief for t in trials if t is not best)
    if not (spec.threshold and onset_levels(spec) and strengths(spec)):
        return ()
    at_levels: dict[tuple[float, ...], int] = {}
    for k, trial in enumerate(trials):
        level = tuple(trial.belief[f"{spec.name}.{p.name}"].value for p in onset_levels(spec))
        if level not in at_levels or scores.drops[k] > scores.drops[at_levels[level]]:
            at_levels[level] = k
    starts = []
    for k in at_levels.values():
        moved = belief.at(belief.coordinates + scores.shifts[: len(belief.free), k])
        start = trials[k].belief
        for p in moved.free:
            start = start.with_parameter(p.key, value=p.value)
        starts.append(start)
    return tuple(starts)
