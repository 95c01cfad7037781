"""Effects whose tangents say nothing, ranked by runs with a few of their sizes or places."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from mphygs.diagnose.contact_search import walls, with_wall
from mphygs.diagnose.ranking import Entry
from mphygs.diagnose.trials import score_trials
from mphygs.diagnose.trials_of import Trial, compliance_trials, hung_trials, plasticity_trials
from mphygs.fit.experiment import Experiment
from mphygs.fit.problem import Evaluation, Problem
from mphygs.fit.side_by_side import side_by_side
from mphygs.model.belief import Belief
from mphygs.model.registry import effect
from mphygs.simulate.errors import SimulationError
from mphygs.simulate.settings import MLS


def tried_effects(
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
) -> list[Entry]:
    """Threshold effects, soft holds, masses of known loads: the best of a few finite trials each, with the
    p-value of the best of so many. What is tried is read off the sequence that is off most."""
    name = evaluation.worst
    _first, last = problem.ranges[name]
    problem = problem.with_ranges({name: problem.ranges[name], **problem.ranges})
    observation = experiment.observations[name]
    groups: dict[str, list[Trial]] = {}
    if names is None or "contact" in names:
        workers = experiment.settings.workers
        found = walls(
            problem, observation, belief, evaluation, share=share, workers=workers, report=report
        )
        groups["contact"] = [Trial("contact", plane.label, with_wall(own, plane)) for own, plane in found]
    if names is None or "plasticity" in names:
        groups["plasticity"] = plasticity_trials(problem.predictors[name], belief, last)
    if (names is None or "hold_compliance" in names) and problem.settings.transfer != MLS:
        groups["hold_compliance"] = compliance_trials(experiment.capture, belief)
    if names is None or "attached_mass" in names:
        groups["attached_mass"] = hung_trials(experiment.capture, belief, list(problem.ranges))

    def tried(own: Experiment, trial: Trial) -> Evaluation | None:
        try:
            return own.window(problem.settings.spacing, share).evaluate(trial.belief, jacobian=False)
        except SimulationError:
            return None

    entries = []
    for kind, trials in groups.items():
        if report:
            for trial in trials:
                report(f"trial: {trial.effect}, {trial.label}")
        changes, kept = [], []
        for trial, moved in zip(trials, side_by_side(experiment, tried, trials), strict=True):
            if moved is not None:
                changes.append(
                    evaluation.residual[: evaluation.data_rows] - moved.residual[: evaluation.data_rows]
                )
                kept.append(trial)
        if not kept:
            continue
        matrix = np.vstack(
            [np.stack(changes, axis=1), np.zeros((len(residual) - len(changes[0]), len(kept)))]
        )
        scores = score_trials(residual, jacobian, matrix, generator=generator)
        trial = kept[scores.best]
        estimate = {
            p.key.rsplit(".", 1)[1]: p.value
            for p in trial.belief.parameters
            if p.key.startswith(f"{kind}.") and p.free
        }
        rows = evaluation.data_rows
        expected = max(float(residual @ residual) - scores.drop, 0.0)
        entries.append(
            Entry(
                kind,
                trial.label,
                effect(kind).kind,
                float(scores.drop),
                float(scores.p_value),
                float(np.sqrt(expected / rows)),
                estimate,
                {},
                trial.belief,
                # Trials of a wall are places, those of other effects sizes: no way leads from one to another.
                others=tuple(t.belief for t in kept if t is not trial) if kind == "contact" else (),
            )
        )
    return entries
