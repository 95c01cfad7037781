"""A graph network trained on the fitted frames and rolled out: what gs-dynamics does.

See `mphygs.baselines.graph_network`. Nodes are markers, as far from one another as can be, and points on
what is held, whose moves are given; it is trained on stretches of the nodes' tracks, turned about gravity at
random, and predicts frame by frame. It knows no gravity, no mass and no law.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import torch
from torch import Tensor

from mphygs.baselines.anchors import Anchors, holds_of
from mphygs.baselines.graph_network import HISTORY, SHAPES, Graph, starting_weights
from mphygs.baselines.mover import Mover, start_of
from mphygs.baselines.targets import TrackTarget
from mphygs.baselines.training import Progress, TrainingPlan, Values, taken, train, trained_values
from mphygs.baselines.weights import as_tensors
from mphygs.fit.experiment import Experiment
from mphygs.fit.run import TRAINED, Run
from mphygs.model.belief import Belief
from mphygs.motion.control_graph import farthest_first
from mphygs.simulate.measurement import lateness
from mphygs.simulate.prediction import Maker, Predictor
from mphygs.simulate.timeline import Timeline

# Free nodes at most.
NODES = 60
STAGES, ITERATIONS, RATE = 10, 90, 2e-3
# Stretches of an iteration, and frames of each, in the thirds of the training.
BATCH, ROLLOUTS = 8, (3, 8, 20)
# Noise on the frames that a stretch begins with, over the markers' own.
NOISE = 0.3
# What the lengths of edges count by, beside places.
LENGTHS = 0.1


class GraphPredictor(Mover):
    """Predicts by the graph network. values: see `maker`."""

    def settle(self) -> None:
        values, recording = self.values, self.recording
        rest, fps = values["nodes"], float(values["fps"][0])
        if abs(recording.fps - fps) > 1e-6 * fps:
            raise ValueError(
                f"sequence '{recording.name}': has {recording.fps:g} frames per second; expected {fps:g}, "
                "those that the graph network was trained on"
            )
        self.anchors = Anchors(rest, holds_of(rest, values["held"], self.body.boxes))
        self.graph = Graph(rest, ~self.anchors.free, float(values["move"][0]))
        self.rows = self.anchors.weights(self.attachment.anchor + self.attachment.offset)

    def moved(self, belief: Belief, last: int) -> tuple[Timeline, np.ndarray, np.ndarray]:
        timeline = self.timeline(belief, last, 1.0 / self.recording.fps)
        ends = np.r_[timeline.schedule["start"], timeline.times]
        held = self.anchors.carried(self.recording, ends)
        place, velocity = start_of(self, belief, self.anchors.rest)
        places = [place]
        moves = np.repeat(velocity[None] / self.recording.fps, HISTORY, axis=0)
        weights = as_tensors(self.values, SHAPES)
        with torch.no_grad():
            for k in range(len(timeline.moving)):
                action = np.zeros_like(place)
                action[~self.anchors.free] = held[k + 1] - held[k]
                state = [torch.as_tensor(x[None], dtype=torch.float32) for x in (places[-1], moves, action)]
                found = self.graph.next(weights, *state, torch.eye(3)[None])[0].numpy().astype(float)
                moves = np.concatenate([moves[1:], (found - places[-1])[None]])
                places.append(found)
        track = np.array(places)
        speed = np.zeros_like(track)
        if len(track) > 1:
            speed = np.gradient(track, 1.0 / self.recording.fps, axis=0)
        return timeline, *self.following(self.rows, self.anchors, timeline, track, speed)


@dataclass(frozen=True, eq=False)
class Shown:
    """What one sequence shows of the nodes. track: (T, n, 3) [m], from the frame in which the motion begins,
    and HISTORY more before it; sigma: of a coordinate [m]; gravity: (3,) direction."""

    track: Tensor
    sigma: float
    gravity: np.ndarray

    @property
    def starts(self) -> int:
        """Frames from which a stretch may begin."""
        return len(self.track) - HISTORY - 1


def maker(run: Run) -> Maker:
    """Predictors by the network of a finished run."""
    values = trained_values(run)
    shapes = SHAPES | {"nodes": (None, 3), "held": (None,), "move": (1,), "fps": (1,)}
    found = dict(zip(shapes, taken(values, run.folder, shapes), strict=True))
    taken(values, run.folder, {"held": (len(found["nodes"]),)})
    if not (found["move"][0] > 0.0 and found["fps"][0] > 0.0 and len(found["nodes"]) > 1):
        raise ValueError(f"{run.folder / TRAINED}: expected two nodes or more, move and fps above zero")
    return partial(GraphPredictor, found)


def fit(run: Run, experiment: Experiment, progress: Progress) -> Run:
    """The complete run of the network. Raises ValueError where sequences differ in their frames per second,
    or one has no frames to learn from."""
    problem = experiment.problem(run.settings.spacing)
    names = list(problem.ranges)
    first = problem.predictors[names[0]]
    for name in names:
        fps = problem.predictors[name].recording.fps
        if fps != first.recording.fps:
            raise ValueError(
                f"sequence '{name}': has {fps:g} frames per second; expected {first.recording.fps:g}, as "
                f"{names[0]} has, for a graph network"
            )
    anchors = nodes_of(first)
    shown = [
        node_tracks(experiment, problem.predictors[n], run.belief, anchors, problem.ranges[n]) for n in names
    ]
    move = np.sqrt(np.mean(np.concatenate([np.diff(s.track.numpy(), axis=0).ravel() ** 2 for s in shown])))
    move = max(float(move), 1e-9)
    graph = Graph(anchors.rest, ~anchors.free, move)
    belief = replace(run.belief, parameters=tuple(replace(p, free=False) for p in run.belief.parameters))
    run = replace(run, belief=belief)

    def measure(values: Mapping[str, np.ndarray], number: int) -> tuple[float, Values]:
        weights = as_tensors(values, SHAPES, slopes=True)
        generator = np.random.default_rng([run.seed, 1, number])
        steps = ROLLOUTS[len(ROLLOUTS) * number // (STAGES * ITERATIONS)]
        cost = _stretches(graph, weights, shown, steps, generator)
        cost.backward()
        slopes = {n: w.grad.numpy().astype(float) for n, w in weights.items()}
        # Long rollouts have slopes of any size: their direction counts.
        size = np.sqrt(sum(float((s**2).sum()) for s in slopes.values()))
        return float(cost.detach()), {n: s / max(size, 1e-12) for n, s in slopes.items()}

    def whole(values: Values) -> float:
        """Of rollouts of all fitted frames from where the motions begin, as they are predicted."""
        cost, rows = 0.0, 0
        for name in names:
            p, observation, span = problem.predictors[name], problem.observations[name], problem.ranges[name]
            mover = GraphPredictor(constants | values, p.capture, p.recording, p.settings, body=p.body)
            target = TrackTarget(observation)
            cost += target.cost(mover.predict(belief, last=span[1]).position, span)[0]
            rows += target.weight(span)
        return cost / rows

    constants = {
        "nodes": anchors.rest, "held": (~anchors.free).astype(float), "move": np.array([move]),
        "fps": np.array([first.recording.fps]),
    }  # fmt: skip
    plan = TrainingPlan(dict.fromkeys(SHAPES, RATE), STAGES, ITERATIONS, whole)
    begun = starting_weights(np.random.default_rng([run.seed, 0]))
    run = train(run, lambda: begun, measure, plan, constants, progress, name="graph")
    return replace(run, covariance=np.zeros((0, 0)), information=np.zeros((0, 0)))


def nodes_of(predictor: Predictor) -> Anchors:
    """Markers that the material carries, as far apart as can be, and points on what holds grip."""
    attachment = predictor.attachment
    places = (attachment.anchor + attachment.offset)[attachment.hold < 0]
    if not len(places):
        raise ValueError(f"sequence '{predictor.recording.name}': no marker moves; expected some that do")
    chosen = places[farthest_first(places, min(NODES, len(places)), from_middle=True)]
    gripped = Anchors.of(predictor.body, 1)
    rest = np.concatenate([chosen, gripped.rest[~gripped.free]])
    hold = np.concatenate([np.full(len(chosen), -1), gripped.hold[~gripped.free]])
    return Anchors(rest, hold)


def node_tracks(
    experiment: Experiment, predictor: Predictor, belief: Belief, nodes: Anchors, span: tuple[int, int]
) -> Shown:
    """The nodes' tracks in the fitted frames, gaps bridged. Raises ValueError for fewer than two frames."""
    recording = predictor.recording
    observation = experiment.observations[recording.name]
    last = span[1]
    begin = recording.release or 0
    if last - begin < 2:
        raise ValueError(f"sequence '{recording.name}': expected two frames or more to fit in a motion")
    attachment = predictor.attachment
    rest = attachment.anchor + attachment.offset
    seen = np.isfinite(observation.position[begin:last]).all(2)
    used = np.flatnonzero(seen.sum(0) >= 2)
    frames = np.arange(last - begin)
    moved = np.empty((last - begin, len(used), 3))
    for k, marker in enumerate(used):
        there = np.flatnonzero(seen[:, marker])
        for axis in range(3):
            own = observation.position[begin + there, marker, axis] - rest[marker, axis]
            moved[:, k, axis] = np.interp(frames, there, own)
    # what holds carry is known, and moves the nodes near it
    times = (begin + frames) / recording.fps + lateness(belief)
    carried = nodes.carried(recording, times)
    held = nodes.rest[~nodes.free]
    source = Anchors(np.concatenate([rest[used], held]), np.full(len(used) + len(held), -1))
    every = np.concatenate([moved, carried - held], axis=1)
    rows = source.weights(nodes.rest)
    track = nodes.rest + np.stack([rows @ frame for frame in every])
    track[:, ~nodes.free] = carried
    start, velocity = start_of(predictor, belief, nodes.rest)
    if recording.release is not None or not velocity.any():
        before = np.repeat(start[None], HISTORY, axis=0)
        track[0] = start
    else:
        before = track[0] - velocity * np.arange(HISTORY, 0, -1)[:, None, None] / recording.fps
    whole = torch.as_tensor(np.concatenate([before, track]), dtype=torch.float32)
    return Shown(whole, observation.sigma, predictor.body.towards(belief.gravity))


def _stretches(
    graph: Graph,
    weights: Mapping[str, Tensor],
    shown: list[Shown],
    steps: int,
    generator: np.random.Generator,
) -> Tensor:
    """Half the mean square of how far rollouts of some stretches end from the tracks [sigma], and of their
    edges' lengths."""
    chances = np.array([s.starts for s in shown], float)
    turned, sigmas = [], []
    for _ in range(BATCH):
        one = shown[generator.choice(len(shown), p=chances / chances.sum())]
        begin = HISTORY + int(generator.integers(one.starts))
        stretch = one.track[begin - HISTORY : begin + 1 + steps]
        if len(stretch) < HISTORY + 1 + steps:
            fill = torch.full((HISTORY + 1 + steps - len(stretch), *stretch.shape[1:]), torch.nan)
            stretch = torch.cat([stretch, fill])
        turn = _turn(one.gravity, generator.uniform(0.0, 2.0 * np.pi))
        turned.append((stretch @ turn.T, turn))
        sigmas.append(one.sigma)
    track, turn = (torch.stack(own) for own in zip(*turned, strict=True))
    sigma = torch.tensor(sigmas, dtype=torch.float32)[:, None, None]
    random = generator.standard_normal((BATCH, HISTORY + 1, *track.shape[2:]))
    noise = NOISE * sigma[..., None] * torch.as_tensor(random, dtype=torch.float32)
    begun = track[:, : HISTORY + 1] + noise * ~graph.held[:, None]
    place, moves, costs = begun[:, -1], begun[:, 1:] - begun[:, :-1], []
    for k in range(steps):
        truth = track[:, HISTORY + 1 + k]
        there = torch.isfinite(truth).all(2).all(1)
        if not there.any():
            break
        was = track[:, HISTORY + k]
        action = torch.where(graph.held[:, None], torch.nan_to_num(truth - was), torch.zeros(()))
        found = graph.next(weights, place, moves, action, turn)
        truth = torch.nan_to_num(truth)
        away = ((found - truth) / sigma)[there][:, ~graph.held]
        longer = ((graph.lengths(found) - graph.lengths(truth)) / sigma[..., 0])[there]
        costs.append(0.5 * (away**2).mean() + LENGTHS * 0.5 * (longer**2).mean())
        moves = torch.cat([moves[:, 1:], (found - place)[:, None]], dim=1)
        place = found
    return torch.stack(costs).mean()


def _turn(gravity: np.ndarray, angle: float) -> Tensor:
    """(3, 3) rotation about gravity; none where there is none."""
    size = float(np.linalg.norm(gravity))
    if size == 0.0:
        return torch.eye(3)
    x, y, z = gravity / size
    across = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    turn = np.eye(3) + np.sin(angle) * across + (1.0 - np.cos(angle)) * across @ across
    return torch.as_tensor(turn, dtype=torch.float32)
