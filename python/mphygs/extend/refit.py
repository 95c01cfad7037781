"""Refit a model with an effect really in it, and judge it on frames that were not fitted."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from mphygs.compare.assess import Assessment, Compared, whiten_all
from mphygs.diagnose.held_out import GainInterval, gain_interval
from mphygs.diagnose.ranking import RankedEffect
from mphygs.diagnose.wall import release_friction
from mphygs.fit.experiment import Experiment
from mphygs.fit.levenberg_marquardt import TOO_LITTLE, Solution, minimise, report_of_iterations
from mphygs.fit.place_fit import relocated
from mphygs.model.belief import Belief
from mphygs.simulate.errors import SimulationError
from mphygs.simulate.scope import in_scope

# Frames of one block of the bootstrap on unseen frames: errors within one swing hang together.
BLOCK_FRAMES = 8
# Of chi^2 on the fitted frames that an effect leaves at most, to be kept without a clear gain on unseen ones.
MOSTLY_EXPLAINED = 0.25
# Of a wall or of yielding: so little left is asked further even where unseen frames do not gain.
NEARLY_ALL = 0.1
# A refit that leaves so much [sigma] is near the floor and not at it: its materials may be where a model
# without the effect had drawn them.
AT_FLOOR, NEAR_FLOOR = 1.03, 1.25
# A refit ends where an iteration brings less than so many times what the last one may promise; more times
# where it leaves more than so much [sigma]: at that pace it does not get near the floor any more.
BRINGS, FAR, BRINGS_FAR = 5.0, 2.0, 50.0
# That of what sets in (a wall, yielding), which is found once more on the deciding grid, from the frames
# before.
BRINGS_SETTING_IN = 20.0


@dataclass(frozen=True, eq=False)
class Refit:
    """A model with an effect added. compared: without tangents, which only the one that is kept needs; gain:
    on unseen frames over the model before; actual_drop: of chi^2 on the fitted frames, to hold against
    entry.statistic."""

    entry: RankedEffect
    solution: Solution
    compared: dict[str, Compared]
    assessment: Assessment
    gain: GainInterval | None
    actual_drop: float

    @property
    def belief(self) -> Belief:
        """The model as refitted."""
        return self.solution.belief

    @property
    def pays(self) -> bool:
        """Whether the effect lowers the error on frames that were not fitted (on fitted ones, where there
        are no others).

        Where the model lacks more than this effect, the rest of the misfit comes and goes over the unseen
        frames, and no interval of a few swings excludes zero: there the gain has to be positive, and most of
        the misfit of the fitted frames explained.
        """
        if self.gain is None:
            return self.actual_drop > 20.0
        return self.gain.accepted or self.gain.gain > 0.0 and self.left < MOSTLY_EXPLAINED

    @property
    def left(self) -> float:
        """Share of chi^2 on the fitted frames that the effect leaves."""
        after = self.solution.evaluation.chi_square
        return after / (after + self.actual_drop)

    @property
    def may_pay(self) -> bool:
        """Whether it is worth asking all frames: something sets in that explains the fitted ones, and what it
        does later (a second touch) the fitted ones leave open. The step pays if all frames are explained."""
        return self.entry.kind == "threshold" and self.actual_drop > 0.0 and self.left < NEARLY_ALL

    @property
    def surprising(self) -> bool:
        """Actual and predicted drop differ by more than a factor of two."""
        return not 0.5 <= self.actual_drop / max(self.entry.statistic, 1e-9) <= 2.0


def finish_refit(
    experiment: Experiment,
    before: Solution,
    compared_before: dict[str, Compared],
    entry: RankedEffect,
    begun: Solution,
    spacing: float,
    *,
    generator: np.random.Generator,
    iterations: int = 10,
    accuracy: float = 1e-4,
    hopeless: float = math.inf,
    report: Callable[[str], None] | None = None,
) -> Refit | None:
    """Bring a refit that was begun to its minimum and judge it.

    accuracy: share of the cost that a last step may promise; hopeless: chi^2 above which it is given up after
    three iterations. None where it is given up, or where its motion cannot be simulated.
    """
    problem = experiment.problem(spacing)
    tell = report_of_iterations(report, f"with {entry.effect}")
    try:
        belief = release_friction(begun.belief)
        # Begun on all frames, it is there with its Jacobian.
        same = belief is begun.belief and begun.evaluation.data_rows == before.evaluation.data_rows
        known = begun.evaluation if same else None
        late = entry.kind == "threshold"
        solution = minimise(
            problem, belief, iterations=3, relative_tolerance=accuracy, known=known,
            least=BRINGS_SETTING_IN * accuracy if late else 0.0, report=tell,
        )  # fmt: skip
        if solution.evaluation.chi_square > hopeless:
            return None
        if not solution.converged and solution.reason != TOO_LITTLE:
            near = BRINGS_SETTING_IN if late else BRINGS
            brings = BRINGS_FAR if solution.evaluation.misfit > FAR else near
            solution = minimise(
                problem, solution.belief, iterations=iterations - 3, relative_tolerance=accuracy,
                least=brings * accuracy, report=tell,
            )  # fmt: skip
        # Materials first: a place that makes up for theirs is hard to leave.
        solution = relocated(problem, solution, relative_tolerance=accuracy, report=report)
        compared = experiment.compare(solution.belief, spacing, jacobian=False)
    except SimulationError:
        return None
    assessment = experiment.assess(compared)
    return Refit(
        entry,
        solution,
        compared,
        assessment,
        unseen_gain(
            *(_in_scope(c, solution.belief, entry.effect) for c in (compared_before, compared)), generator
        ),
        before.evaluation.chi_square - solution.evaluation.chi_square,
    )


def _in_scope(compared: dict[str, Compared], belief: Belief, name: str) -> dict[str, Compared]:
    """The comparisons of the sequences that have an effect: what only some have is judged by those."""
    if name not in belief.effects:
        return compared
    return {key: item for key, item in compared.items() if in_scope(belief, name, key)}


def unseen_gain(
    before: dict[str, Compared], after: dict[str, Compared], generator: np.random.Generator
) -> GainInterval | None:
    """Bootstrap interval of the log-likelihood gain over all unseen frames; None where there are too few."""
    a, b = whiten_all(before), whiten_all(after)
    unseen = ~a.fitted
    if not unseen.any():
        return None
    blocks = a.sequence[unseen] * 100_000 + a.frame[unseen] // BLOCK_FRAMES
    if len(np.unique(blocks)) < 4:
        blocks = a.sequence[unseen] * 100_000 + a.frame[unseen] // 2
    if len(np.unique(blocks)) < 4:
        return None
    gain = gain_interval(a.residual[unseen], b.residual[unseen], blocks, generator=generator)
    falls = [_unseen_square(before[name]) - _unseen_square(after[name]) for name in before]
    return replace(gain, plain=float(np.nanmean(falls)))


def _unseen_square(item: Compared) -> float:
    """Mean square of the distance in unseen frames, per coordinate [sigma^2]; NaN where there are none."""
    window = slice(*item.predict)
    apart = item.observation.position[window] - item.predicted[window]
    apart /= item.observation.frames_of_noise[window, None, None]
    apart = apart[item.observation.observed[window]]
    return float(np.mean(apart**2)) / item.observation.sigma**2 if len(apart) else np.nan
