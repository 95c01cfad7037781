"""Which grid a model stands on: coarse while the misfit is gross, finer where it could be the grid's own."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from mphygs.compare.assess import PRACTICAL_FLOOR
from mphygs.extend.step import Step, excess
from mphygs.fit.experiment import Experiment
from mphygs.fit.levenberg_marquardt import minimise
from mphygs.fit.schedule import default_spacing, simulable
from mphygs.simulate.errors import SimulationError

# On the screening grid a misfit [sigma] below the first number, or an excess below this share of that of the
# first model, may be the grid's own: the default grid is asked.
GROSS, EXPLAINED_ON_COARSE = 3.0, 0.1
# On the default grid a misfit below this many sigma is asked of a grid finer by this factor.
SMALL, FINER = 1.6, 1.5
# The error of a displacement falls with the square of the spacing, its mean square with the fourth power.
ORDER = 4
ITERATIONS = 8


def next_spacing(experiment: Experiment, steps: Sequence[Step]) -> float | None:
    """Spacing [m] on which the last step should be asked again, None where its grid will do."""
    first, last = steps[0], steps[-1]
    default = default_spacing(experiment.capture)
    if last.spacing > 1.1 * default:
        small = excess(last.assessment) < EXPLAINED_ON_COARSE * excess(first.assessment)
        return default if last.assessment.worst < GROSS or last.added and small else None
    if last.spacing > default / FINER * 1.1 and last.assessment.worst < SMALL:
        return default / FINER
    return None


def on_grid(
    experiment: Experiment, step: Step, spacing: float, report: Callable[[str], None] | None = None
) -> Step | None:
    """The step refitted on another grid, None where it cannot be simulated there."""
    say = report or (lambda _text: None)
    say(f"refitting on a grid of {1e3 * spacing:.3g} mm")
    try:
        problem = experiment.problem(spacing)
        belief = simulable(problem, step.belief)

        def tell(iteration: int, evaluation: object, _belief: object) -> None:
            rms = (evaluation.chi_square / max(evaluation.data_rows, 1)) ** 0.5
            say(f"{1e3 * spacing:.3g} mm: iteration {iteration}, {rms:.3f} sigma")

        solution = minimise(problem, belief, iterations=ITERATIONS, relative_tolerance=1e-3, report=tell)
        compared = experiment.compare(solution.belief, spacing)
    except SimulationError as error:
        say(f"grid of {1e3 * spacing:.3g} mm: {error}")
        return None
    assessment = experiment.assess(compared)
    say(f"{step.assessment.worst:.3f} -> {assessment.worst:.3f} sigma in the worst range")
    return replace(
        step,
        belief=solution.belief,
        solution=solution,
        compared=compared,
        assessment=assessment,
        spacing=spacing,
    )


def extrapolated(coarse: Step, fine: Step) -> float:
    """Root mean square over sigma [1] of the worst range on a grid of spacing zero (Richardson, 1911)."""
    gain = (coarse.spacing / fine.spacing) ** ORDER
    worst = 1.0
    for name, ranges in fine.assessment.ratio.items():
        for label, ratio in ranges.items():
            before = coarse.assessment.ratio[name][label]
            worst = max(worst, ratio**2 - max(before**2 - ratio**2, 0.0) / (gain - 1.0))
    return float(worst**0.5)


def refined(experiment: Experiment, steps: Sequence[Step], report: Callable[[str], None] | None) -> Step:
    """The last step on the grid that its misfit asks for.

    On a grid finer than the default only the floor is asked for: reached there, or by what the two grids say
    of a third without error. What is left otherwise is looked for on the default grid, at a fraction of the
    work.
    """
    say = report or (lambda _text: None)
    current = steps[-1]
    while not current.explained:
        spacing = next_spacing(experiment, [*steps[:-1], current])
        if spacing is None:
            break
        finer = on_grid(experiment, current, spacing, report)
        if finer is None:
            break
        if spacing < 0.9 * default_spacing(experiment.capture) and not finer.explained:
            limit = extrapolated(current, finer)
            say(f"without the grids' error: {limit:.3f} sigma")
            if limit > PRACTICAL_FLOOR:
                break
            finer = replace(finer, assessment=replace(finer.assessment, adequate=True))
        current = finer
    return current
