"""Effects found while another one was missing, held once more against what may stand in their place.

The second of two causes bends the motion while the first is looked for: what then led by little may be the
wrong one of several that do nearly alike.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from mphygs.compare.assess import LARGEST_EXCUSED
from mphygs.extend.model_selection import best_of_rivals, on_the_grid_of, step_of
from mphygs.extend.refit import AT_FLOOR, Refit
from mphygs.extend.refits import refits_of
from mphygs.extend.step import Step, excess
from mphygs.extend.window_ranking import ranked_on_window
from mphygs.fit.experiment import Experiment
from mphygs.fit.levenberg_marquardt import minimise, report_of_iterations
from mphygs.fit.schedule import SCREENING_ACCURACY
from mphygs.simulate.errors import SimulationError

# Iterations of the model without the effect, from where the whole model is: it need not get to its end.
ITERATIONS = 4
# Of what may stand in an effect's place so many are asked on the grid that decides.
RIVALS = 4


def with_effects_exchanged(
    experiment: Experiment,
    steps: Sequence[Step],
    spacing: float,
    generator: np.random.Generator,
    *,
    names: Sequence[str] | None = None,
    report: Callable[[str], None] | None = None,
) -> Step | None:
    """A further step, with another effect in the place of an earlier one; None where none does better.

    spacing: of the grid that models are tried on [m]; names: effects that may be added (None: all). Nothing
    is asked of a model that is at the noise, or far from it.
    """
    current = steps[-1]
    near = current.explained or current.assessment.worst <= LARGEST_EXCUSED
    if not near or current.assessment.worst <= AT_FLOOR:
        return None
    for name in dict.fromkeys(name for step in steps[:-1] for name in step.added):
        if name not in current.belief.effects or name in current.added:
            continue
        found = _in_place_of(name, experiment, current, spacing, generator, names, report)
        if found is not None:
            return found
    return None


def _in_place_of(
    name: str,
    experiment: Experiment,
    current: Step,
    spacing: float,
    generator: np.random.Generator,
    names: Sequence[str] | None,
    report: Callable[[str], None] | None,
) -> Step | None:
    """The step with another effect than the named one, where that explains more."""
    say = report or (lambda _text: None)
    say(f"what may stand in the place of {name}, now that {', '.join(current.added)} is in the model")
    try:
        refits, window_share = _tried(name, experiment, current, spacing, generator, names, report)
    except SimulationError:
        return None
    own = [excess(r.assessment) for r in refits if r.entry.effect == name]
    limit = min(own) if own else np.inf
    better = [r for r in refits if r.entry.effect != name and r.pays and excess(r.assessment) < limit]
    better.sort(key=lambda r: excess(r.assessment))
    rivals = [step_of(r, spacing, (), window_share) for r in better[:RIVALS]]
    if not current.explained:
        # Only beside what is explained others are asked on its grid.
        moved = [on_the_grid_of(experiment, current, rival, report) for rival in rivals]
        rivals = [rival for rival in moved if rival is not None]
    if not rivals:
        return None
    try:
        own = replace(current, added=(name,), ties=(), refits=(), warnings=())
        chosen = best_of_rivals(experiment, own, rivals, report)
    except SimulationError:
        return None
    if chosen.added == (name,) or excess(chosen.assessment) >= excess(current.assessment):
        return None
    say(f"{chosen.added[0]} in the place of {name}")
    return replace(chosen, dropped=(name,))


def _tried(
    name: str,
    experiment: Experiment,
    current: Step,
    spacing: float,
    generator: np.random.Generator,
    names: Sequence[str] | None,
    report: Callable[[str], None] | None,
) -> tuple[list[Refit], float]:
    """One round of the loop for the model without the named effect: refits, and the share of the frames that
    they were found on. Raises SimulationError."""
    say = report or (lambda _text: None)
    lacking = minimise(
        experiment.problem(spacing),
        current.belief.without_effect(name),
        iterations=ITERATIONS,
        relative_tolerance=SCREENING_ACCURACY,
        report=report_of_iterations(report, f"without {name}"),
    )
    compared = experiment.compare(lacking.belief, spacing, jacobian=False)
    step = Step(lacking.belief, lacking, compared, experiment.assess(compared), spacing, current.added)
    window, afar, ranking = ranked_on_window(experiment, step, spacing, generator, names=names, report=report)
    found = refits_of(experiment, step, window, ranking, spacing, generator, say, afar=afar, onward=False)
    return found, window[0]
