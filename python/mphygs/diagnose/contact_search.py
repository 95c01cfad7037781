"""Where a wall could stand: planes that the prediction passes through, moved until the motion after is right.

What a wall changes is no smooth function of where it stands, and tangents are of little use: planes are
compared by forward runs, which begin shortly before the misfit does.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize

from mphygs.compare.noise import Observation
from mphygs.diagnose.wall import Plane, with_wall
from mphygs.fit.problem import Evaluation, Problem
from mphygs.fit.stiffness_scale import find_scale, stiffened, with_materials_at_prior
from mphygs.model.belief import Belief
from mphygs.model.descriptor import EffectSpec
from mphygs.model.registry import effect
from mphygs.simulate.errors import SimulationError
from mphygs.simulate.settings import MLS
from mphygs.simulate.transfer import Start

DIRECTIONS, APART = 400, 0.95
# Planes that are tried where the markers' own limits put them; of these so many are moved, in so many runs
# each, where the best of them leaves no more than this share of the misfit.
TRIED, MOVED, RUNS, HELPS = 20, 2, 40, 0.8
# Tilt [rad] and depth (of the deepest passing) that a search begins with.
TILT, DEPTH = 0.2, 0.3
# The misfit begins where a frame is this many sigma off; runs begin so many frames before.
BEGINS, BEFORE = 2.0, 3
# A model off by so many sigma within so much of the frames may be too stiff to reach a wall; shares of its
# stiffness with which it would.
OFF, EARLY, SOFTER = 1.25, 0.25, (0.6, 0.4, 0.25)


@dataclass(frozen=True, eq=False)
class _Proposal:
    """A plane through the outermost of all measured points along its normal. pivot: (3,) where the
    prediction passes it [m]; depth: by how much at most [m]."""

    plane: Plane
    pivot: np.ndarray
    depth: float


def sphere(count: int) -> np.ndarray:
    """(count, 3) unit vectors spread evenly (Fibonacci lattice)."""
    k = np.arange(count) + 0.5
    z = 1.0 - 2.0 * k / count
    angle = np.pi * (1.0 + 5.0**0.5) * k
    ring = np.sqrt(1.0 - z * z)
    return np.stack([ring * np.cos(angle), ring * np.sin(angle), z], axis=1)


def proposals(
    predicted: np.ndarray, measured: np.ndarray, sigma: float, *, count: int = TRIED
) -> list[_Proposal]:
    """Planes that no measured marker ever passed but the prediction does, the most violated first.

    predicted, measured: (T, M, 3) [m], NaN where missing; sigma: of a coordinate [m].
    """
    seen = np.isfinite(measured).all(-1)
    points, expected = measured[seen], predicted[seen]
    if not len(points):
        return []
    misfit = points - expected
    found = []
    for n in sphere(DIRECTIONS):
        limit = float(np.min(points @ n))
        depth = np.maximum(limit - 3.0 * sigma - expected @ n, 0.0)
        if not np.any(depth > 0):
            continue
        # What a wall along n would explain: misfit that points out of it, where the prediction is behind it.
        gain = float(np.sum(np.minimum(depth, np.maximum(misfit @ n, 0.0)) ** 2))
        pivot = (depth[:, None] * points).sum(0) / depth.sum()
        plane = Plane(n, limit - 2.0 * sigma)
        found.append((gain, _Proposal(plane, pivot, float(depth.max()))))
    found.sort(key=lambda item: -item[0])
    chosen: list[_Proposal] = []
    for _, proposal in found:
        if all(proposal.plane.normal @ other.plane.normal < APART for other in chosen):
            chosen.append(proposal)
        if len(chosen) == count:
            break
    return chosen


class _Runs:
    """chi^2 of a problem's first sequence with a wall, by runs that begin shortly before it is felt."""

    def __init__(
        self,
        problem: Problem,
        observation: Observation,
        belief: Belief,
        evaluation: Evaluation,
        spec: EffectSpec,
    ) -> None:
        self.belief, self.spec = belief, spec
        self.name, (self.first, self.last) = next(iter(problem.ranges.items()))
        self.predictor, self.observation = problem.predictors[self.name], observation
        self.whitener = observation.whitener(self.first, self.last)
        self.before = evaluation.positions[self.name]
        residual = observation.position[self.first : self.last] - self.before[self.first : self.last]
        # A frame that shows no marker is not off.
        allowed = (BEGINS * observation.sigma) ** 2 * np.isfinite(residual).sum(axis=(1, 2))
        off = np.nansum(residual**2, axis=(1, 2)) > allowed
        begin = self.first + int(np.argmax(off)) - BEFORE if off.any() else 0
        self.start = self._start(begin)
        if belief.prestress == "equilibrium":
            # A wall leaves the rest shape alone: solved for once, here, as threads may not share a solver.
            self.predictor.rest_shape.solve(belief)

    def proposals(self) -> list[_Proposal]:
        """Planes that this motion passes and the measured one does not."""
        window = slice(self.first, self.last)
        measured = self.observation.position[window]
        return proposals(self.before[window], measured, self.observation.sigma)

    def _start(self, frame: int) -> Start | None:
        """The state of the model without a wall at a frame; None where runs begin at rest."""
        # Where effects have a history the state is more than place and velocity.
        memory = any(effect(name).history for name in self.belief.effects)
        if frame < 2 or memory or self.predictor.settings.transfer == MLS:
            return None
        timeline = self.predictor.timeline(
            self.belief, frame + 1, self.predictor.stable_substep(self.belief)
        )
        displacement, velocity = self.predictor.states(self.belief, timeline)[:2]
        if len(timeline.moving) == 0:
            return None
        return Start(frame, displacement[-1], velocity[-1], np.zeros((displacement.shape[1], 3, 3)))

    def chi_square(self, plane: Plane | None) -> float:
        """With a wall, or without; infinite where the run is unstable."""
        position = self.before.copy()
        if plane is not None:
            walled = with_wall(self.belief, self.spec, plane)
            try:
                found = self.predictor.predict(walled, last=self.last, start=self.start)
            except SimulationError:
                return np.inf
            position[found.frames] = found.position
        window = slice(self.first, self.last)
        difference = np.nan_to_num(self.observation.position[window] - position[window])
        residual = self.whitener.whiten(difference)
        return float(residual @ residual)


def _moved(proposal: _Proposal, at: np.ndarray) -> Plane:
    """The plane tilted about its pivot by two angles [TILT] and pushed along its normal [DEPTH of depth]."""
    n = proposal.plane.normal
    across = np.linalg.svd(n[None])[2][1:]
    tilted = n + TILT * at[:2] @ across
    tilted /= np.linalg.norm(tilted)
    push = proposal.plane.offset - n @ proposal.pivot
    return Plane(tilted, float(tilted @ proposal.pivot + push + DEPTH * proposal.depth * at[2]))


def _better_place(runs: _Runs, proposal: _Proposal) -> Plane:
    """The plane of a proposal moved to where the motion after is right, by the simplex of Nelder and Mead."""
    simplex = np.vstack([np.zeros(3), np.eye(3)])
    result = minimize(
        lambda at: runs.chi_square(_moved(proposal, at)),
        np.zeros(3),
        method="Nelder-Mead",
        options={"initial_simplex": simplex, "maxfev": RUNS, "xatol": 1e-2, "fatol": 1.0},
    )
    plane = _moved(proposal, result.x)
    return Plane(plane.normal, plane.offset, float(result.fun))


def search(
    problem: Problem,
    observation: Observation,
    belief: Belief,
    evaluation: Evaluation,
    spec: EffectSpec,
    *,
    workers: int = 1,
    report: Callable[[str], None] | None = None,
) -> list[Plane]:
    """Planes that explain the misfit best, the best first; none where the prediction passes no free plane.

    problem: its first sequence is looked at; observation: of that; evaluation: of the belief, without wall;
    spec: the effect that a plane brings.
    """
    if spec.name in belief.effects:
        return []
    # Planes are tried side by side, on a core each.
    runs = _Runs(problem.twin(1), observation, belief, evaluation, spec)
    found = runs.proposals()
    if not found:
        return []
    with ThreadPoolExecutor(workers) as pool:
        tried = list(pool.map(lambda p: runs.chi_square(p.plane), found))
        order = np.argsort(tried)[:MOVED]
        best, alone = tried[order[0]], runs.chi_square(None)
        if report:
            report(f"{len(found)} planes tried: chi^2 {best:.0f} of {alone:.0f}")
        if best > HELPS * alone:
            plane = found[order[0]].plane
            return [Plane(plane.normal, plane.offset, best)] if np.isfinite(best) else []
        chosen = [found[k] for k in order if np.isfinite(tried[k])]
        planes = list(pool.map(lambda p: _better_place(runs, p), chosen))
    planes.sort(key=lambda plane: plane.chi_square)
    if report:
        for plane in planes:
            report(f"{plane.label}: chi^2 {plane.chi_square:.0f}")
    return planes


def softer(problem: Problem, belief: Belief) -> list[tuple[Belief, Evaluation]]:
    """Beliefs with all parts of one material, softer than fits the first frames best, and their evaluations;
    those that cannot be simulated left out. Raises SimulationError where none at all can be."""
    alike, found = find_scale(problem, with_materials_at_prior(belief)), []
    for share in SOFTER:
        soft = stiffened(alike, share)
        try:
            found.append((soft, problem.evaluate(soft, jacobian=False)))
        except SimulationError:
            continue
    return found


def search_softer(
    problem: Problem,
    observation: Observation,
    belief: Belief,
    evaluation: Evaluation,
    spec: EffectSpec,
    *,
    workers: int = 1,
    report: Callable[[str], None] | None = None,
) -> list[tuple[Belief, Plane]]:
    """Planes that a softer object would have met from its first frames on, each with its belief, the best
    first.

    What a wall stops from the beginning is fitted as too stiff to reach it, and passes no plane. Arguments as
    those of `search`; none where a wall explains too little beyond the belief as it was fitted.
    """
    if spec.name in belief.effects:
        return []
    try:
        models = softer(problem, belief)
    except SimulationError:
        return []
    # A rest shape belongs to one belief: each has simulators of its own.
    ways = [_Runs(problem.twin(1), observation, *model, spec) for model in models]
    tried = [(runs, proposal) for runs in ways for proposal in runs.proposals()]
    if not tried:
        return []
    fitted = _left(problem, evaluation)
    with ThreadPoolExecutor(workers) as pool:
        left = list(pool.map(lambda item: item[0].chi_square(item[1].plane), tried))
        chosen = [tried[k] for k in np.argsort(left)[:MOVED] if np.isfinite(left[k])]
        planes = list(pool.map(lambda item: _better_place(*item), chosen))
    pairs = [(runs.belief, plane) for (runs, _), plane in zip(chosen, planes, strict=True)]
    pairs = sorted(pairs, key=lambda pair: pair[1].chi_square)
    if report:
        best = pairs[0][1].chi_square
        report(f"{len(tried)} planes tried with softer parts: chi^2 {best:.0f} of {fitted:.0f}")
    return [pair for pair in pairs if pair[1].chi_square < HELPS * fitted]


def _left(problem: Problem, evaluation: Evaluation) -> float:
    """chi^2 of a problem's first sequence."""
    residual = evaluation.residual[evaluation.rows[next(iter(problem.ranges))]]
    return float(residual @ residual)


def walls(
    problem: Problem,
    observation: Observation,
    belief: Belief,
    evaluation: Evaluation,
    spec: EffectSpec,
    *,
    share: float = 1.0,
    workers: int = 1,
    report: Callable[[str], None] | None = None,
) -> list[tuple[Belief, Plane]]:
    """Planes that may be walls, the best first, each with the belief that meets it: this one, or where it is
    off from its first frames on and no plane helps it, a softer one.

    share: of the fitted frames that the problem is of; other arguments as those of `search`.
    """
    given = {"workers": workers, "report": report}
    found = [(belief, plane) for plane in search(problem, observation, belief, evaluation, spec, **given)]
    helped = any(plane.chi_square < HELPS * _left(problem, evaluation) for _, plane in found)
    if not helped and not belief.effects and share <= EARLY and evaluation.misfit > OFF:
        found = search_softer(problem, observation, belief, evaluation, spec, **given) or found
    return found
