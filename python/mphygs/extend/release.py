"""From a fit under feedback to a free one: the feedback lowered in stages."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress

from mphygs.fit.experiment import Experiment
from mphygs.fit.levenberg_marquardt import Solution, minimise, told
from mphygs.simulate.errors import SimulationError

# Gains on the way from full feedback to none: each halves what holds the model.
RELEASE = (0.1, 0.0)


def released(
    experiment: Experiment,
    solution: Solution,
    spacing: float,
    *,
    iterations: int = 6,
    accuracy: float = 1e-3,
    report: Callable[[str], None] | None = None,
) -> Solution:
    """The free fit that an assimilated one leads to, the feedback lowered in stages.

    Raises SimulationError where the model cannot run free.
    """
    problem = experiment.problem(spacing)
    for gain in RELEASE[:-1]:
        with suppress(SimulationError):
            tell = told(report, f"released to {gain:g} ({1e3 * spacing:.3g} mm)")
            solution = minimise(
                problem.under(gain), solution.belief, iterations=2, relative_tolerance=accuracy, report=tell
            )
    tell = told(report, f"released ({1e3 * spacing:.3g} mm)")
    return minimise(problem, solution.belief, iterations=iterations, relative_tolerance=accuracy, report=tell)
