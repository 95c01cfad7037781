"""A graph network that says where nodes stand in the next frame, after gs-dynamics.

Zhang et al., "Dynamic 3D Gaussian tracking for graph-based neural dynamics modeling" (2024), and the message
passing of Li et al., "Learning particle dynamics" (2019): encoders of nodes and edges, propagation steps, a
displacement of every node. Nodes show what they are and how they moved in the last frames, those of a hold
their next move as well; edges how their nodes stand to each other now and at rest.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor

# Frames that a node shows, units of every layer, propagation steps, and edges of a node.
HISTORY, WIDTH, STEPS, EDGES = 3, 48, 3, 6
_NODE, _EDGE = 1 + 3 * HISTORY + 3, 8
_LAYERS = {"node": _NODE, "edge": _EDGE, "message": 3 * WIDTH, "update": 2 * WIDTH, "out": WIDTH}
SHAPES = {
    f"{layer}.{name}": shape
    for layer, size in _LAYERS.items()
    for name, shape in (
        ("weight0", (WIDTH, size)),
        ("bias0", (WIDTH,)),
        ("weight1", (3 if layer == "out" else WIDTH, WIDTH)),
        ("bias1", (3 if layer == "out" else WIDTH,)),
    )
}


def starting_weights(generator: np.random.Generator) -> dict[str, np.ndarray]:
    """By name, of a network by which nodes go on as they moved."""
    out = {}
    for name, shape in SHAPES.items():
        still = "bias" in name or name == "out.weight1"
        out[name] = np.zeros(shape) if still else generator.standard_normal(shape) * np.sqrt(1.5 / shape[-1])
    return out


def edges_of(rest: np.ndarray) -> np.ndarray:
    """(2, E) node that hears and node that is heard: the nearest of every one of (n, 3) at rest [m]."""
    count = min(EDGES, len(rest) - 1)
    _, index = cKDTree(rest).query(rest, count + 1)
    pairs = np.stack([np.repeat(np.arange(len(rest)), count), index[:, 1:].ravel()])
    return np.unique(np.concatenate([pairs, pairs[::-1]], axis=1), axis=1)


class Graph:
    """Nodes, edges, and what counts as one: lengths of edges and moves in a frame [m]."""

    def __init__(self, rest: np.ndarray, held: np.ndarray, move: float) -> None:
        """rest: (n, 3) [m]; held: (n,) bool; move: root mean square of a node's in a frame [m]."""
        self._to, self._by = (torch.from_numpy(k.astype(np.int64)) for k in edges_of(rest))
        self.held = torch.from_numpy(held)
        self._type = torch.as_tensor(held[:, None], dtype=torch.float32)
        rest = torch.as_tensor(rest, dtype=torch.float32)
        self._apart = rest[self._by] - rest[self._to]
        self.length = float(self._apart.norm(dim=1).mean())
        self.move = move

    def next(
        self, weights: Mapping[str, Tensor], place: Tensor, moves: Tensor, action: Tensor, turn: Tensor
    ) -> Tensor:
        """Places one frame later, (B, n, 3) [m].

        place: (B, n, 3) [m]; moves: (B, HISTORY, n, 3) in the frames before, the last one last [m]; action:
        (B, n, 3) the next move of held nodes, zero for others [m]; turn: (B, 3, 3) rotation by which the
        object was turned with everything that it feels, what it was at rest included.
        """
        batch, count = place.shape[:2]
        kind = self._type.expand(batch, -1, -1)
        history = moves.permute(0, 2, 1, 3).reshape(batch, count, -1)
        node = _layers(weights, "node", torch.cat([kind, history / self.move, action / self.move], dim=2))
        apart = place[:, self._by] - place[:, self._to]
        before = self._apart @ turn.transpose(1, 2)
        stretch = apart.norm(dim=2, keepdim=True) / before.norm(dim=2, keepdim=True) - 1.0
        strained = (apart - before) / self.move
        shown = [before / self.length, strained, self.length / self.move * stretch]
        shown.append((self._type[self._by] - self._type[self._to]).expand(batch, -1, -1))
        edge = _layers(weights, "edge", torch.cat(shown, dim=2))
        for _ in range(STEPS):
            heard = torch.cat([edge, node[:, self._to], node[:, self._by]], dim=2)
            message = _layers(weights, "message", heard)
            total = torch.zeros_like(node).index_add(1, self._to, message)
            node = node + _layers(weights, "update", torch.cat([node, total], dim=2))
        moved = moves[:, -1] + self.move * _layers(weights, "out", node)
        return place + torch.where(self.held[:, None], action, moved)

    def lengths(self, place: Tensor) -> Tensor:
        """(B, E) of all edges of places (B, n, 3) [m]."""
        return (place[:, self._by] - place[:, self._to]).norm(dim=2)


def _layers(weights: Mapping[str, Tensor], name: str, x: Tensor) -> Tensor:
    x = torch.relu(x @ weights[f"{name}.weight0"].T + weights[f"{name}.bias0"])
    return x @ weights[f"{name}.weight1"].T + weights[f"{name}.bias1"]
