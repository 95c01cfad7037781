"""The stage on pictures: materials that lower L_2D, from where the fit to the tracks ended.

The carriers' motion is taken as linear in the unknowns about the belief (tangents of one simulation), L_2D of
the Gaussians that they drive is minimised over the unknowns by L-BFGS, and the step is kept where a new
simulation lowers L_2D on frames that were left out; else half of it is tried. What the tracks said holds the
unknowns that pictures do not feel: the rise of their chi^2 counts, relative to it, by TRACK_WEIGHT.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from scipy.optimize import minimize
from torch import Tensor

from mphygs.capture.views import Photograph
from mphygs.fit.levenberg_marquardt import Solution
from mphygs.fit.paper import adam
from mphygs.fit.paper_plan import ITERATIONS
from mphygs.fit.pictured import Pictured
from mphygs.model.belief import Belief
from mphygs.render.video_loss import FrameObservation, VideoWeights, observation_of, video_loss
from mphygs.simulate.errors import SimulationError
from mphygs.simulate.prediction import Prediction
from mphygs.simulate.prediction_gradient import predict_with_gradient

# Frames of a sequence that are compared, fitted ones and left-out ones between them, and the longest side of
# their pictures [px]; that of pictures whose features are taken, as in `mphygs segment`.
FITTED_FRAMES, LEFT_OUT_FRAMES, LARGEST_SIDE = 8, 4, 160
LOOKS_SIDE = 400
ROUNDS, EVALUATIONS, HALVINGS = 2, 25, 3
TRACK_WEIGHT = 0.1
# No logarithm moves further in one round.
LONGEST_STEP = 0.5
# Share by which L_2D must fall to be worth another round.
WORTH = 2e-3


@dataclass(frozen=True, eq=False)
class ImageFit:
    """belief: the best found; history: L_2D on the fitted frames after every round that was kept, the first
    before any; left_out: the same on the frames left out."""

    belief: Belief
    history: tuple[float, ...]
    left_out: tuple[float, ...]


@dataclass(frozen=True, eq=False)
class Watched:
    """Frames of one sequence that are compared. photographs, pictures: what was seen, by frame."""

    fitted: tuple[int, ...]
    left_out: tuple[int, ...]
    photographs: Mapping[int, Sequence[Photograph]]
    pictures: Mapping[int, Sequence[FrameObservation]]

    @property
    def last(self) -> int:
        """Frames to simulate."""
        return max((*self.fitted, *self.left_out)) + 1


def fit_to_pictures(
    pictured: Pictured,
    solution: Solution,
    *,
    weights: VideoWeights,
    report: Callable[[str], None] | None = None,
) -> ImageFit:
    """Lower L_2D from a solution of the tracks; the belief stays as it is where nothing lowers it.

    solution: with Jacobian. Raises SimulationError where its belief cannot be simulated.
    """
    looks = weights.features > 0
    spans = pictured.experiment.fitted.items()
    watched = {name: watch(pictured, name, span, looks=looks) for name, span in spans}
    belief = solution.belief
    jacobian = solution.evaluation.jacobian
    normal = jacobian.T @ jacobian / max(2.0 * solution.evaluation.cost, 1e-300)
    origin = belief.coordinates
    keys = [p.key for p in belief.free]

    def moved(at: Belief, wanted: Sequence[str] = ()) -> dict[str, Prediction]:
        return {name: pictured.moved(name, at, last=w.last, keys=wanted) for name, w in watched.items()}

    def losses(found: Mapping[str, Prediction]) -> tuple[float, float]:
        return tuple(
            float(
                np.mean([_loss(pictured, name, w, found[name], frames, weights) for name, w, frames in rows])
            )
            for rows in (
                [(name, w, w.fitted) for name, w in watched.items()],
                [(name, w, w.left_out) for name, w in watched.items()],
            )
        )

    now = moved(belief, keys)
    fitted, left_out = losses(now)
    history, kept_out = [fitted], [left_out]
    if report:
        report(f"pictures: L_2D {fitted:.5f}, {left_out:.5f} on frames left out")
    for _ in range(ROUNDS):
        step = _best_step(pictured, watched, now, weights, normal, belief.coordinates - origin, fitted)
        better = None
        for halving in range(HALVINGS):
            trial = belief.at(belief.coordinates + 0.5**halving * step)
            try:
                found = moved(trial)
            except SimulationError:
                continue
            one, other = losses(found)
            if report:
                report(f"pictures: a step gives L_2D {one:.5f}, {other:.5f} on frames left out")
            if one < fitted and other < left_out:
                better = (trial, one, other)
                break
        if better is None:
            break
        worth = fitted - better[1] > WORTH * fitted
        belief, fitted, left_out = better
        history.append(fitted)
        kept_out.append(left_out)
        if not worth:
            break
        now = moved(belief, keys)
    return ImageFit(belief, tuple(history), tuple(kept_out))


def watch(pictured: Pictured, name: str, span: tuple[int, int], *, looks: bool) -> Watched:
    """Frames spread over a range, and what the cameras saw in them. looks: whether features are compared."""
    first, last = span
    frames = np.unique(np.linspace(first, last - 1, FITTED_FRAMES + LEFT_OUT_FRAMES).round().astype(int))
    # every third is left out, never the last one
    left_out = frames[1:-1:3] if len(frames) > 3 else frames
    fitted = np.setdiff1d(frames, left_out) if len(frames) > 3 else frames
    views = pictured.views(name)
    photographs, pictures = {}, {}
    for frame in map(int, frames):
        found = views.read(frame)
        photographs[frame] = [p.within(LARGEST_SIDE) for p in found]
        features = [None] * len(found)
        if looks and pictured.looks is not None:
            features = [pictured.looks.of(p.within(LOOKS_SIDE)) for p in found]
        pictures[frame] = [
            observation_of(p, None if seen is None else _no_finer(seen, p.mask.shape))
            for p, seen in zip(photographs[frame], features, strict=True)
        ]
    return Watched(tuple(map(int, fitted)), tuple(map(int, left_out)), photographs, pictures)


def _no_finer(features: Tensor, shape: tuple[int, int]) -> Tensor:
    """A map (h, w, F) by means at a resolution that is at most `shape`."""
    height, width = (min(have, most) for have, most in zip(features.shape[:2], shape, strict=True))
    if (height, width) == tuple(features.shape[:2]):
        return features
    channels = features.permute(2, 0, 1)
    return torch.nn.functional.adaptive_avg_pool2d(channels, (height, width)).permute(1, 2, 0)


def _loss(
    pictured: Pictured,
    name: str,
    watched: Watched,
    prediction: Prediction,
    frames: Sequence[int],
    weights: VideoWeights,
) -> float:
    """L_2D, mean over frames."""
    with torch.no_grad():
        return float(
            np.mean(
                [
                    float(_frame_loss(pictured, name, watched, prediction.position[t], t, weights))
                    for t in frames
                ]
            )
        )


def _frame_loss(
    pictured: Pictured,
    name: str,
    watched: Watched,
    positions: np.ndarray | Tensor,
    frame: int,
    weights: VideoWeights,
) -> Tensor:
    placement = pictured.placement(name)
    points = torch.as_tensor(positions)
    world = points @ torch.from_numpy(placement.rotation).T + torch.from_numpy(placement.position)
    return video_loss(pictured.drawn.at(world), watched.pictures[frame], weights=weights).total


def _best_step(
    pictured: Pictured,
    watched: Mapping[str, Watched],
    now: Mapping[str, Prediction],
    weights: VideoWeights,
    normal: np.ndarray,
    away: np.ndarray,
    start: float,
) -> np.ndarray:
    """Change of the coordinates (P,) that minimises L_2D of the linearised motion, relative to its start,
    plus the tracks' share. away: from the minimum of the tracks to here."""
    count = len(normal)
    frames = [(name, w, t) for name, w in watched.items() for t in w.fitted]
    shares = {name: 1.0 / (len(w.fitted) * len(watched)) for name, w in watched.items()}
    # in units of what the tracks determine well, so that L-BFGS sees one scale
    scale = np.clip(1.0 / np.sqrt(np.diag(normal) + 1e-12), None, 1.0)

    def measure(point: np.ndarray) -> tuple[float, np.ndarray]:
        step = scale * point
        total, gradient = 0.0, np.zeros(count)
        for name, one, t in frames:
            slope = now[name].jacobian[t]
            positions = torch.from_numpy(now[name].position[t] + slope @ step).requires_grad_()
            loss = _frame_loss(pictured, name, one, positions, t, weights)
            loss.backward()
            total += shares[name] * float(loss.detach()) / start
            bar = positions.grad.numpy()
            gradient += shares[name] / start * np.einsum("mc,mck->k", bar, slope)
        apart = away + step
        total += TRACK_WEIGHT * float(apart @ normal @ apart)
        gradient += 2.0 * TRACK_WEIGHT * normal @ apart
        return total, scale * gradient

    bounds = [(-LONGEST_STEP / s, LONGEST_STEP / s) for s in scale]
    found = minimize(
        measure, np.zeros(count), jac=True, method="L-BFGS-B", bounds=bounds, options={"maxfun": EVALUATIONS}
    )
    return scale * found.x


def fit_to_pictures_by_adam(
    pictured: Pictured,
    belief: Belief,
    *,
    weights: VideoWeights,
    report: Callable[[str], None] | None = None,
) -> ImageFit:
    """The paper's last stage: Adam on L_2D over all fitted frames that are watched, through the adjoint.

    L_2D counts relative to its start, as many times as pictures are compared, beside the priors. Raises
    SimulationError where the belief cannot be simulated.
    """
    looks = weights.features > 0
    spans = pictured.experiment.fitted.items()
    watched = {name: watch(pictured, name, span, looks=looks) for name, span in spans}
    problem = pictured.experiment.problem(pictured.experiment.settings.spacing)
    keys = tuple(p.key for p in belief.free)

    def losses(at: Belief) -> tuple[float, float]:
        found = {name: pictured.moved(name, at, last=w.last) for name, w in watched.items()}
        return tuple(
            float(np.mean([_loss(pictured, n, w, found[n], frames(w), weights) for n, w in watched.items()]))
            for frames in (lambda w: w.fitted, lambda w: w.left_out)
        )

    start = losses(belief)
    compared = sum(len(w.pictures[t]) for w in watched.values() for t in w.fitted)

    def measure(at: Belief) -> tuple[float, np.ndarray]:
        residual, jacobian = problem.prior_rows(at)
        cost, gradient = 0.5 * float(residual @ residual), jacobian.T @ residual
        for name, one in watched.items():
            share = compared / (start[0] * len(watched) * len(one.fitted))
            total = 0.0

            def slope(position: np.ndarray, name: str = name, one: Watched = one, share: float = share):
                nonlocal total
                total, bar = 0.0, np.zeros_like(position)
                for t in one.fitted:
                    points = torch.from_numpy(position[t].copy()).requires_grad_()
                    loss = _frame_loss(pictured, name, one, points, t, weights)
                    loss.backward()
                    total += share * float(loss.detach())
                    bar[t] = share * points.grad.numpy()
                return bar

            last = max(one.fitted) + 1
            _, part = predict_with_gradient(pictured.predictor(name), at, slope, keys=keys, last=last)
            cost, gradient = cost + total, gradient + part
        if not np.isfinite(cost) or not np.isfinite(gradient).all():
            raise SimulationError("the prediction or its gradient is not finite")
        return cost, gradient

    def tell(iteration: int, cost: float) -> None:
        if report:
            report(f"pictures: iteration {iteration} of {ITERATIONS}, cost {cost:.4g}")

    found, _ = adam(measure, belief, tell)
    end = losses(found)
    if end[0] >= start[0]:
        return ImageFit(belief, (start[0],), (start[1],))
    return ImageFit(found, (start[0], end[0]), (start[1], end[1]))
