"""The whole loop: fit, compare, diagnose, extend, until the error is explained or nothing known does so."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from mphygs.compare.assess import Compared
from mphygs.diagnose.outliers import bad_observations
from mphygs.diagnose.ranking import Ranking
from mphygs.extend.candidate_table import Row, candidate_rows
from mphygs.extend.coarse_grid_search import on_coarse_grid
from mphygs.extend.conclusion import Discovery, conclude
from mphygs.extend.effect_exchange import with_effects_exchanged
from mphygs.extend.effect_pruning import with_effects_pruned
from mphygs.extend.first_fit import first_fit
from mphygs.extend.grids import converged_fit, finely, with_budget
from mphygs.extend.model_selection import best_and_rivals, selected_model, step_of
from mphygs.extend.nested_models import with_simpler_effects
from mphygs.extend.reconcile import reconciled
from mphygs.extend.refits import refits_of
from mphygs.extend.required_grid import on_required_grid
from mphygs.extend.seen_faults import seen_faults
from mphygs.extend.simplest_recordings import compared_on_all, explains, sequences_without_loads
from mphygs.extend.step import FAULT, Step, excess, known_budget, leaves_most
from mphygs.extend.step_uncertainty import bounded, undetermined
from mphygs.extend.track_readmission import with_tracks_readmitted
from mphygs.extend.window_ranking import ranked_on_window
from mphygs.fit.experiment import Experiment
from mphygs.fit.spacings import FINE, deciding_spacing, screening_spacing
from mphygs.model.belief import Belief
from mphygs.simulate.errors import SimulationError

# Effects in a model; steps of the loop, exchanges included. A second one that leaves most of what was left
# is not followed by a third.
LARGEST_MODEL, LONGEST = 3, 8
# An effect that leaves more than this share of the excess over noise and does not reach the floor is not
# what is missing: some effect always bends the curve a little.
TOO_LITTLE = 0.8
def mask_outliers(experiment: Experiment, compared: dict[str, Compared]) -> int:
    """Leave bad tracks out of all observations. Returns the number of measurements left out."""
    total = 0
    for name, item in compared.items():
        first, last = item.frames
        residual = np.full_like(item.observation.position, np.nan)
        residual[first:last] = item.observation.position[first:last] - item.predicted[first:last]
        residual /= item.observation.frames_of_noise[:, None, None]
        markers = experiment.capture.sequence(name).markers
        bad = bad_observations(residual, markers.at, item.observation.sigma)
        # Frames outside the compared ranges keep what they have.
        count = int((bad & item.observation.observed).sum())
        if count:
            position = np.where(bad[..., None], np.nan, item.observation.position)
            experiment.observations[name] = replace(item.observation, position=position)
            total += count
    return total


def discover_effects(
    experiment: Experiment,
    belief: Belief,
    spacing: float,
    *,
    seed: int = 0,
    names: Sequence[str] | None = None,
    start: Sequence[Step] = (),
    screening: bool = False,
    final: bool = True,
    report: Callable[[str], None] | None = None,
    on_step: Callable[[Step, Sequence[Ranking]], None] | None = None,
) -> Discovery:
    """Find what is missing from a model of a capture.

    belief: the model to start from, not yet fitted; names: effects that may be added (None: all);
    start: steps that are done already, the first model's fit the first of them; screening: the spacing is
    only for trying many models, and models near the floor are asked again on the deciding grid; final:
    whether what is concluded is told, or gone on from; on_step: told every new step, and the rankings so far,
    as soon as it is done.
    Raises SimulationError when not even the first model can be simulated.
    """
    say, coarse = report or (lambda _text: None), spacing
    steps = list(start) or [first_fit(experiment, belief, spacing, report=report)]
    rankings: list[Ranking] = []
    warnings: list[str] = []  # of the round that goes on
    table: tuple[Row, ...] = ()  # of the last round that came to nothing

    def done(step: Step) -> None:
        steps.append(replace(step, warnings=(*warnings, *step.warnings)))
        warnings.clear()
        if on_step:
            on_step(steps[-1], rankings)

    if on_step and not start:
        on_step(steps[0], rankings)

    def without_bad_tracks() -> None:
        """One more step where tracks are bad; looked for anew as long as none was found."""
        current = steps[-1]
        allowed = names is None or FAULT in names
        known = any(FAULT in step.added for step in steps)
        if known or not allowed or current.assessment.adequate:
            return
        left_out = mask_outliers(experiment, current.compared)
        if not left_out:
            return
        say(f"{left_out} measurements do not move with their neighbours: left out as {FAULT}")
        experiment.problems.clear()
        after = first_fit(experiment, current.belief, current.spacing, report=report, warm=True)
        done(replace(after, added=(FAULT,)))

    def judged(step: Step) -> Step:
        """The step, asked for all frames where only unseen ones are off, on the grid that decides."""
        if screening and step.spacing > FINE * deciding_spacing(experiment.capture):
            return step
        after = reconciled(experiment, step, report)
        if not after.reconciled:
            return after
        text = (
            f"{' + '.join(after.added) or 'first model'}: fitted to all frames it explains them; what "
            "it misses of unseen frames is what the fitted ones leave open"
        )
        return replace(after, warnings=(*after.warnings, text))

    without_bad_tracks()
    # What was found before a loop was stopped was asked all this then.
    fresh = all(set(step.added) <= {FAULT} for step in steps)
    if fresh:
        steps[-1] = judged(on_required_grid(experiment, steps, report, screening=screening))
    simple = sequences_without_loads(experiment)
    if simple and fresh and not steps[-1].explained:
        say(f"first {', '.join(simple)}: no load pulls there")
        inner = experiment.only(simple)
        alone = discover_effects(
            inner, belief, spacing, seed=seed, names=names, screening=screening, final=False, report=report
        )
        experiment.problems.clear()  # bad tracks may have been left out
        rankings.extend(alone.rankings)
        warnings.extend(alone.warnings)
        table = alone.table
        among = []
        for step in alone.steps[1:]:
            try:
                found = compared_on_all(experiment, steps[0].belief, step)
                among.append(replace(found, table=step.table))
            except SimulationError as error:
                say(f"{', '.join(step.added)}, for all recordings: {error}")
                break
        for step in among:  # told only now: a loop that is stopped has all of them or none
            done(step)
    while not steps[-1].explained and len(steps[-1].belief.terms) < LARGEST_MODEL:
        if names is not None and set(names) <= set(steps[-1].belief.effects):
            break
        if not simple and leaves_most(steps):
            say(f"{', '.join(steps[-1].added)}: leaves most of what was left; no further effect is tried")
            break
        current = steps[-1]
        if screening:
            current = on_coarse_grid(experiment, current, coarse, report, simple=simple)
        spacing = current.spacing
        experiment.whole = simple if simple and explains(current, simple) else ()
        # Every step draws its own numbers: a loop that was stopped goes on as if it had not been.
        generator = np.random.default_rng((seed, len(steps)))
        window, afar, ranking = ranked_on_window(
            experiment, current, spacing, generator, names=names, report=report
        )
        rankings.append(ranking)
        for entry in ranking.entries[:6]:
            say(
                f"  {entry.label}: chi^2 would fall by {entry.statistic:.0f} of {ranking.chi_square:.0f}, "
                f"p {entry.p_value:.2g}"
            )
        fates: dict[str, str] = {}
        finished = refits_of(
            experiment, current, window, ranking, spacing, generator, say, afar=afar, fates=fates
        )

        def rows(
            kept: Step | None, why: str = "", of: tuple = (ranking, finished, fates, current.belief)
        ) -> tuple[Row, ...]:
            return candidate_rows(*of, kept, why)

        for r in finished:
            if window[0] == 1.0 and r.surprising:
                warnings.append(
                    f"{r.entry.effect}: predicted drop of chi^2 {r.entry.statistic:.0f}, "
                    f"actual {r.actual_drop:.0f}"
                )
        refits = [r for r in finished if r.pays] or [r for r in finished if r.may_pay]
        if not refits:
            table = rows(None)
            break
        best, rivals = best_and_rivals(refits)
        step = step_of(best, spacing, finished, window[0])
        others = [step_of(r, spacing, (), window[0]) for r in rivals]
        last = selected_model(experiment, steps, step, others, report, screening=screening)
        earlier = [name for before in steps for name in before.added]
        if simple or last.explained or not leaves_most([*steps, last]):
            last = with_effects_pruned(experiment, last, earlier, report)
        step = judged(last)
        if not best.pays and not step.explained:
            say(f"{best.entry.effect}: does not pay on unseen frames")
            table = rows(None)
            break
        if not step.explained and excess(step.assessment) > TOO_LITTLE * excess(steps[-1].assessment):
            say(f"{', '.join(step.added)}: explains too little of what is left")
            table = rows(None, "explains too little of what is left")
            break
        done(replace(step, table=rows(step)))
        without_bad_tracks()
    experiment.whole = ()
    while len(steps) < LONGEST:
        generator = np.random.default_rng((seed, len(steps)))
        step = with_effects_exchanged(experiment, steps, coarse, generator, names=names, report=report)
        step = step and judged(step)
        if step is None or not step.explained:
            break
        done(step)
    if steps[-1].explained and FAULT in [name for step in steps for name in step.added]:
        steps[-1] = with_tracks_readmitted(experiment, steps[-1], report)
    if steps[-1].explained:
        if screening and final:
            steps[-1] = finely(experiment, steps[-1], report)
        # What is concluded is told to its last digits, what was found with the grid's share of its errors.
        steps[-1] = converged_fit(experiment, steps[-1], report)
        if steps[-1].added and not known_budget(steps[-1]):
            coarser = screening_spacing(experiment.capture)
            steps[-1] = with_budget(experiment, steps[-1], report, refinement_spacing=coarser)
        steps[-1] = bounded(with_simpler_effects(experiment, steps[-1], report), experiment)
    return replace(
        conclude(
            steps, rankings, warnings, seen_faults(experiment), final=final,
            unsure=undetermined(steps[-1], experiment) if steps[-1].explained else (),
        ),  # fmt: skip
        table=next((step.table for step in steps if step.table), table),
    )
