"""The materials of a model fitted from the start, where they may lie in a minimum that is not theirs."""

from __future__ import annotations

from collections.abc import Callable

from mphygs.fit.experiment import Experiment
from mphygs.fit.levenberg_marquardt import Solution, minimise, told
from mphygs.fit.schedule import find_scale, forget, screening_spacing
from mphygs.simulate.errors import SimulationError

# Of the frames, one after the other, on which materials begin anew.
SHARES, ITERATIONS = (0.25, 0.5, 1.0), 8
# Of the cost of some of the frames, by which a fit from the start has to be better there to be followed on,
# beyond what a fit to these alone gains by chance: half of one for each number that is fitted, and once more.
BETTER = 2e-3
# Times that cost at their start: the first frames led to a minimum of their own.
ASTRAY = 25.0


def fitted_anew(
    experiment: Experiment,
    solution: Solution,
    spacing: float,
    report: Callable[[str], None] | None = None,
) -> Solution:
    """The fit, or the one with its materials from the start where that costs less.

    Materials that were fitted beside an effect which is gone, without one that is there now, or on a grid
    that hardly carries thin parts, may lie in a minimum that was its own. They begin on the first frames;
    where they do no better than those of the fit on half of them, or cannot be simulated, the fit is kept.
    """
    try:
        return _fitted_anew(experiment, solution, spacing, report)
    except SimulationError:
        return solution


def _fitted_anew(
    experiment: Experiment, solution: Solution, spacing: float, report: Callable[[str], None] | None
) -> Solution:
    say = report or (lambda _text: None)
    # Their common scale is told by a coarse grid as well, where soft bodies take less long to come to rest.
    rough = max(spacing, screening_spacing(experiment.capture))
    belief = find_scale(experiment.window(rough, SHARES[0]), forget(solution.belief))
    for share in SHARES:
        problem = experiment.window(spacing, share)
        halfway = SHARES[0] < share < 1.0
        if halfway:
            known = problem.evaluate(solution.belief, jacobian=False).cost
            if problem.evaluate(belief, jacobian=False).cost > ASTRAY * known:
                say(f"materials anew: astray on {share:.0%} of the frames")
                return solution
        found = minimise(
            problem,
            belief,
            iterations=ITERATIONS,
            relative_tolerance=1e-3,
            report=told(report, f"materials anew, {share:.0%} of the frames"),
        )
        belief = found.belief
        if halfway and found.evaluation.cost > (1.0 - BETTER) * known - len(belief.free):
            say(f"materials anew: no better on {share:.0%} of the frames")
            return solution
    say(f"materials anew: cost {solution.evaluation.cost:.6g} -> {found.evaluation.cost:.6g}")
    return found if found.evaluation.cost < solution.evaluation.cost else solution
