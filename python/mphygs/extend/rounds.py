"""One round of the loop: score every candidate, refit those that lead, and tell who predicts best."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from mphygs.compare.assess import Compared, whiten_all
from mphygs.diagnose.criteria import CRITERIA, Criteria
from mphygs.diagnose.propose import proposals
from mphygs.diagnose.scan import Scan, Scored, scan
from mphygs.extend.contend import FAILURES, Contender, Predictive, contenders, gain_of, predictive
from mphygs.extend.release import released
from mphygs.fit.experiment import Experiment
from mphygs.fit.levenberg_marquardt import Solution, minimise
from mphygs.fit.side_by_side import side_by_side
from mphygs.model.belief import Belief
from mphygs.simulate.settings import TOTAL_LAGRANGIAN

Say = Callable[[str], None]
# Of the cost, what a last step under feedback may promise: far from the data a hundred times as much.
ACCURACY = 1e-4


@dataclass(frozen=True, eq=False)
class Beside:
    """A model beside the measurement. gain: of the feedback, the least with which it stays near the data;
    predictive: how well it predicts under it."""

    solution: Solution
    predictive: Predictive
    gain: float

    @property
    def belief(self) -> Belief:
        return self.solution.belief


@dataclass(frozen=True, eq=False)
class Round:
    """scan: of all candidates; contenders: those that were refitted; finalists: those that the winner is
    among, the best first, none where nothing pays; share: mean square that the grid has of its own
    [noise's]; free: whether they stay near the data without feedback."""

    beside: Beside
    scan: Scan
    contenders: tuple[Contender, ...]
    finalists: tuple[Contender, ...] = ()
    share: float = 0.0
    free: bool = False


def gains_of(experiment: Experiment) -> tuple[float, ...]:
    """Gains of the feedback from a memory of 2 / fps to none; no feedback where the transfer has none."""
    return (1.0, 0.1, 0.01, 0.0) if experiment.settings.transfer == TOTAL_LAGRANGIAN else (0.0,)


def is_near(compared: Mapping[str, Compared], criteria: Criteria) -> bool:
    """Whether tangents say what a model lacks (see `Criteria.share`), in fitted frames and in the others."""
    for fitted in (True, False):
        off = moved = 0.0
        for item in compared.values():
            frame = np.arange(*item.frames)
            inside = (item.fit[0] <= frame) & (frame < item.fit[1])
            position = item.observation.position[frame[inside == fitted]]
            seen = np.isfinite(position).all(-1)
            place = np.where(seen[..., None], position, 0.0)
            mean = place.sum(0) / np.maximum(seen.sum(0), 1)[:, None]
            square = item.observation.sigma**2
            off += np.sum((position - item.predicted[frame[inside == fitted]])[seen] ** 2) / square
            moved += np.sum((position - mean)[seen] ** 2) / square
        if off > criteria.share**2 * moved:
            return False
    return True


def assimilated(
    experiment: Experiment,
    belief: Belief,
    spacing: float,
    *,
    first: float = 1.0,
    criteria: Criteria = CRITERIA,
    say: Say = lambda _text: None,
) -> Beside:
    """A belief fitted under feedback, which is then lowered as long as the model stays near the data. first:
    gain to begin with.

    Raises SimulationError where it cannot be simulated under any feedback.
    """
    found: Beside | None = None
    gains = [gain for gain in gains_of(experiment) if gain <= first]
    for gain in gains:
        problem = experiment.problem(spacing).under(gain)
        try:
            solution = minimise(
                problem,
                belief if found is None else found.belief,
                iterations=8 if found is None else 2,
                relative_tolerance=ACCURACY,
            )
            compared = experiment.compare(solution.belief, spacing, jacobian=False, gain=gain)
            told = predictive(compared, criteria)
            noise = max(told.misfit) < criteria.near
            far = not noise and (gain == 0.0 or not is_near(compared, criteria))
            if found is not None and far:
                break
        except FAILURES:
            if found is None and gain == gains[-1]:
                raise
            if found is None:
                continue
            break
        found = Beside(solution, told, gain)
        say("under feedback {:g}: {:.3f} sigma fitted, {:.3f} unseen".format(gain, *found.predictive.misfit))
        if far:
            break
    return found


def held_round(
    experiment: Experiment,
    beside: Beside,
    spacing: float,
    *,
    fine: float,
    seed: Sequence[int],
    names: Sequence[str] | None = None,
    criteria: Criteria = CRITERIA,
    say: Say = lambda _text: None,
) -> Round:
    """What a model lacks most. fine: spacing of the grid that decides [m]."""
    evaluation = beside.solution.evaluation
    problem = experiment.problem(spacing).under(beside.gain)
    ways, trials = proposals(experiment, problem, beside.belief, evaluation, names=names)
    found = scan(
        experiment, problem, beside.belief, evaluation, ways, trials,
        generator=np.random.default_rng(tuple(seed)), criteria=criteria, report=say,
    )  # fmt: skip
    for s in found.by_effect()[:8]:
        if s.struck is None:
            say(f"  {s.label}: chi^2 would fall by {s.drop:.0f} of {found.chi_square:.0f}")
    tried = contenders(
        experiment,
        spacing,
        beside.gain,
        beside.solution,
        _leading(found, criteria),
        criteria=criteria,
        report=say,
    )
    round_ = Round(beside, found, tuple(tried))
    paying = _paying(round_, criteria)
    beside_data = [t for t in paying if t.predictive.misfit[0] < criteria.near]
    if not beside_data:
        # More is missing: only feedback tells them apart.
        return replace(round_, finalists=tuple(paying))
    freed = side_by_side(experiment, _freed(spacing, criteria), beside_data)
    running = [t for t in freed if t.struck is None]
    for t in running:
        say("  {} free: {:.3f} sigma fitted, {:.3f} unseen".format(t.effect, *t.free_predictive.misfit))
    near = [t for t in running if t.free_predictive.misfit[0] < criteria.near]
    if not near:
        return replace(round_, finalists=tuple(paying))
    near.sort(key=lambda t: -t.free_predictive.log_score.sum())
    share = own_share(experiment, near[0].free.belief, spacing, fine)
    say(f"  the grid has {share**0.5:.2f} sigma of its own")
    rows = near[0].free_predictive.count.sum()
    best = near[0].free_predictive.log_score.sum()
    bound = 0.5 * rows * max(share, criteria.grid)
    finalists = [t for t in near if best - t.free_predictive.log_score.sum() <= bound]
    return replace(round_, finalists=tuple(finalists[: criteria.decided]), share=share, free=True)


def _leading(found: Scan, criteria: Criteria) -> list[Scored]:
    alive = [s for s in found.by_effect() if s.struck is None and s.worth(found.price, found.scale) > 0.0]
    if not alive:
        return []
    most = max(s.drop for s in alive)
    return [s for k, s in enumerate(alive) if k < 2 or s.drop > criteria.promising * most][
        : criteria.refitted
    ]


def worth_of(round_: Round, t: Contender, scale: float) -> float:
    """What a contender brings in log score: of what was fitted less the price of its numbers, and of what was
    not."""
    before = round_.beside.solution.evaluation.chi_square
    drop = (before - t.solution.evaluation.chi_square) / scale
    gain, _ = gain_of(round_.beside.predictive, t.predictive, scale)
    return 0.5 * (drop - round_.scan.price * t.scored.numbers) + gain


def scale_of(contenders_: Sequence[Contender]) -> float:
    """Mean square that the best of some refits leaves [noise's]."""
    left = [t.solution.evaluation.misfit for t in contenders_ if t.solution is not None]
    return max(min(left, default=1.0) ** 2, 1.0)


def _paying(round_: Round, criteria: Criteria) -> list[Contender]:
    """Contenders whose numbers pay, and that do not predict worse what was not fitted, the best first."""
    alive = [t for t in round_.contenders if t.struck is None]
    scale = scale_of(alive)
    worth = {t.effect: worth_of(round_, t, scale) for t in alive}
    paying = []
    for t in sorted(alive, key=lambda t: -worth[t.effect]):
        gain, se = gain_of(round_.beside.predictive, t.predictive, scale)
        if worth[t.effect] > 0.0 and gain > -criteria.tied * se:
            paying.append(t)
    return [t for t in paying if worth[t.effect] > criteria.rival * worth[paying[0].effect]][
        : criteria.finalists
    ]


def _freed(spacing: float, criteria: Criteria) -> Callable[[Experiment, Contender], Contender]:
    def freed(own: Experiment, t: Contender) -> Contender:
        try:
            s = released(own, t.solution, spacing)
            compared = own.compare(s.belief, spacing, jacobian=False)
        except FAILURES as error:
            return replace(t, struck=f"does not run free: {str(error).splitlines()[0]}")
        return replace(t, free=s, free_predictive=predictive(compared, criteria))

    return freed


def own_share(experiment: Experiment, belief: Belief, spacing: float, beside: float) -> float:
    """Mean square that a grid has of its own in a free run [noise's], less what the materials take up: the
    change on another grid, of spacing `beside` [m], extrapolated. Nothing where that cannot carry the
    model."""
    if beside == spacing:
        return 0.0
    try:
        w = whiten_all(experiment.compare(belief, spacing, refine=True, beside=beside))
    except FAILURES:
        return 0.0
    basis = np.linalg.qr(w.jacobian)[0]
    left = w.refinement - basis @ (basis.T @ w.refinement)
    return float(left @ left / max(len(left), 1))


def simplest(
    scores: Sequence[tuple[Belief, str, Predictive]], share: float, criteria: Criteria = CRITERIA
) -> tuple[int, tuple[str, ...]]:
    """Which of some models to take, (belief, effect, how well it predicts): of those that the best cannot be
    told from the one with fewest numbers; and the effects of the others of them.

    Told apart are two whose difference is more than its standard error allows, and more than the grid has of
    its own, share [mean square in the noise's].
    """
    best = max(range(len(scores)), key=lambda k: scores[k][2].log_score.sum())
    top = scores[best][2]
    rows = float(top.count.sum())
    scale = max(-2.0 * top.log_score.sum() / rows, 1.0)

    def told(other: Predictive) -> bool:
        gain, se = gain_of(other, top, scale, unseen=False)
        return gain > criteria.tied * se and gain > 0.5 * share * rows / scale

    alike = [k for k in range(len(scores)) if k == best or not told(scores[k][2])]
    alike.sort(key=lambda k: (numbers_of(scores[k][0], scores[k][1]), -scores[k][2].log_score.sum()))
    return alike[0], tuple(scores[k][1] for k in alike[1:])


def numbers_of(belief: Belief, name: str) -> int:
    """Numbers that an effect brings, its place included."""
    free = sum(p.free and p.key.startswith(f"{name}.") for p in belief.parameters)
    return free + 3 * (name in belief.effects and "place" in belief.term(name).settings)


def table_of(round_: Round | None, chosen: str | None = None, ties: Sequence[str] = ()) -> tuple[dict, ...]:
    """One row a candidate: what it promised, what its refit gained, and why it is out."""
    if round_ is None:
        return ()
    done = {t.effect: t for t in round_.contenders}
    scale = scale_of(round_.contenders)
    before, rows = round_.beside.solution.evaluation.chi_square, []
    for s in round_.scan.by_effect():
        t = done.get(s.effect)
        refitted = t is not None and t.predictive is not None
        gain, se = gain_of(round_.beside.predictive, t.predictive, scale) if refitted else (None, None)
        estimate, struck = dict(s.estimate), s.struck
        if refitted:
            own = [p for p in (t.free or t.solution).belief.parameters if p.key.startswith(f"{s.effect}.")]
            estimate = {p.key.split(".", 1)[1]: p.value for p in own}
        if t is not None and struck is None:
            struck = t.struck
        if struck is None and t is None:
            struck = "its promise does not pay for its numbers" if s.drop <= 0.0 else "others promise more"
        rows.append(
            {
                "effect": s.effect,
                "way": s.label,
                "predicted_drop": s.drop,
                "drop": before - t.solution.evaluation.chi_square if refitted else None,
                "gain": gain,
                "gain_se": se if se is not None and np.isfinite(se) else None,
                "numbers": s.numbers,
                "estimate": estimate,
                "std": dict(s.std),
                "ties": list(ties) if s.effect == chosen else [],
                "struck": struck,
            }
        )
    return tuple(rows)
