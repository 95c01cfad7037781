"""A few control points that carry all Gaussians: the motions that tracking can find.

Embedded deformation (Sumner, Schmid and Pauly 2007): every control point has a place and a rotation, a
Gaussian follows the four that are nearest along the object, and neighbouring control points should agree.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components, dijkstra
from scipy.spatial import cKDTree

from mphygs.capture.rotation import (
    matrix_from_quaternion,
    quaternion_from_matrix,
    quaternion_from_rotation_vector,
)

CARRIERS = 4  # control points that a point follows
_NEIGHBOURS = 8  # of a point, in the graph along which lengths are measured
_MEASURED = 5000  # points of that graph
_GAP = 3.0  # of the median distance between them, which no edge of it crosses


@dataclass(frozen=True, eq=False)
class Pose:
    """Of J control points. position: (J, 3) [m]; rotation: (J, 3, 3), from rest."""

    position: np.ndarray
    rotation: np.ndarray

    def moved(self, step: np.ndarray) -> Pose:
        """The pose after a step (J, 6): rotation vector [rad], in world axes, and shift [m]."""
        turn = matrix_from_quaternion(quaternion_from_rotation_vector(step[:, :3]))
        return Pose(self.position + step[:, 3:], turn @ self.rotation)

    def turned(self, rotation: np.ndarray, shift: np.ndarray) -> Pose:
        """The pose after a rigid motion x -> R x + p of the whole."""
        return Pose(self.position @ rotation.T + shift, rotation @ self.rotation)


@dataclass(frozen=True, eq=False)
class ControlGraph:
    """J control points and the K points that they carry.

    nodes: (J, 3) at rest [m]; points: (K, 3) at rest [m]; carriers: (K, 4) node indices, the first the
    heaviest; weights: (K, 4), sum 1; edges: (E, 2), each pair of neighbouring nodes once in either direction;
    spacing: mean length of an edge [m].
    """

    nodes: np.ndarray
    points: np.ndarray
    carriers: np.ndarray
    weights: np.ndarray
    edges: np.ndarray
    spacing: float

    @property
    def rest(self) -> Pose:
        """Nothing moved."""
        return Pose(self.nodes.copy(), np.tile(np.eye(3), (len(self.nodes), 1, 1)))

    def arms(self, pose: Pose, chosen: np.ndarray | slice = slice(None)) -> np.ndarray:
        """From its nodes to each point, turned with them: (K, 4, 3) [m]."""
        carriers = self.carriers[chosen]
        offset = self.points[chosen, None] - self.nodes[carriers]
        return np.einsum("kaij,kaj->kai", pose.rotation[carriers], offset)

    def carried(self, pose: Pose, chosen: np.ndarray | slice = slice(None)) -> np.ndarray:
        """Where the points are, (K, 3) [m]."""
        places = pose.position[self.carriers[chosen]] + self.arms(pose, chosen)
        return (self.weights[chosen, :, None] * places).sum(axis=1)

    def turns(self, pose: Pose, chosen: np.ndarray | slice = slice(None)) -> np.ndarray:
        """How the points have turned from rest: unit quaternions (K, 4) wxyz, means of their nodes'."""
        quaternion = quaternion_from_matrix(pose.rotation)[self.carriers[chosen]]
        # q and -q are one rotation: all on the side of the first
        side = np.where((quaternion * quaternion[:, :1]).sum(-1, keepdims=True) < 0, -1.0, 1.0)
        mean = (self.weights[chosen, :, None] * side * quaternion).sum(axis=1)
        return mean / np.linalg.norm(mean, axis=1, keepdims=True)

    def pose_of(self, places: np.ndarray) -> Pose:
        """The pose of nodes that puts the points at `places` (K, 3) [m] as well as rigid pieces can.

        Each node takes the rigid motion that fits best the points it carries (Kabsch, weighted).
        """
        count = len(self.nodes)
        flat, weight = self.carriers.ravel(), self.weights.ravel()
        total = np.bincount(flat, weight, count)
        centres = []
        for points in (self.points, places):
            spread = np.repeat(points, CARRIERS, axis=0) * weight[:, None]
            sums = np.stack([np.bincount(flat, spread[:, axis], count) for axis in range(3)], axis=1)
            centres.append(sums / total[:, None])
        before = np.repeat(self.points, CARRIERS, axis=0) - centres[0][flat]
        after = np.repeat(places, CARRIERS, axis=0) - centres[1][flat]
        products = np.einsum("n,ni,nj->nij", weight, after, before).reshape(-1, 9)
        moment = np.stack([np.bincount(flat, products[:, k], count) for k in range(9)], axis=1)
        u, _, vt = np.linalg.svd(moment.reshape(-1, 3, 3))
        sign = np.linalg.det(u @ vt)
        u[:, :, 2] *= sign[:, None]
        rotation = u @ vt
        shift = np.einsum("jab,jb->ja", rotation, self.nodes - centres[0])
        return Pose(centres[1] + shift, rotation)


def control_graph(points: np.ndarray, *, count: int, seeds: np.ndarray | None = None) -> ControlGraph:
    """Spread `count` control points over points (K, 3) [m] of an object, and bind the points to them.

    seeds: (K,) bool, points that may become control points; None for all. Control points are chosen farthest
    first; a point follows the four nearest along a graph of nearest neighbours, so that petals that only come
    close to each other move on their own.
    Raises ValueError for fewer points than control points, or fewer than five of either.
    """
    points = np.asarray(points, dtype=np.float64)
    candidates = np.arange(len(points)) if seeds is None else np.flatnonzero(seeds)
    if count <= CARRIERS or len(candidates) < count:
        raise ValueError(
            f"{count} control points on {len(candidates)} Gaussians; expected more than {CARRIERS} "
            "control points and at least as many Gaussians"
        )
    # lengths are measured along some of the points: more make them no truer
    some = candidates[:: max(1, len(candidates) // max(_MEASURED, 2 * count))]
    chosen = farthest_first(points[some], count)
    length = _lengths(points[some], chosen)
    to_some, beside = cKDTree(points[some]).query(points)
    length = length[:, beside] + to_some
    nearest = np.argpartition(length, CARRIERS, axis=0)[: CARRIERS + 1].T
    distance = np.take_along_axis(length.T, nearest, axis=1)
    order = np.argsort(distance, axis=1, kind="stable")
    nearest, distance = (np.take_along_axis(each, order, axis=1) for each in (nearest, distance))
    weights = (1.0 - distance[:, :CARRIERS] / np.maximum(distance[:, CARRIERS:], 1e-12)) ** 2
    # a point as far from all five follows them alike
    weights += 1e-6
    weights /= weights.sum(axis=1, keepdims=True)
    carriers = nearest[:, :CARRIERS]
    nodes = points[some][chosen]
    edges = _edges(carriers, count)
    edge_length = np.linalg.norm(nodes[edges[:, 0]] - nodes[edges[:, 1]], axis=1)
    return ControlGraph(nodes, points, carriers, weights, edges, float(edge_length.mean()))


def farthest_first(points: np.ndarray, count: int, *, from_middle: bool = False) -> np.ndarray:
    """Indices (count,) of points, each the farthest from those before it; the first the farthest out, or the
    nearest to the middle."""
    out = np.linalg.norm(points - points.mean(axis=0), axis=1)
    chosen = np.zeros(count, dtype=np.int64)
    chosen[0] = int(np.argmin(out) if from_middle else np.argmax(out))
    distance = np.linalg.norm(points - points[chosen[0]], axis=1)
    for k in range(1, count):
        chosen[k] = int(np.argmax(distance))
        distance = np.minimum(distance, np.linalg.norm(points - points[chosen[k]], axis=1))
    return chosen


def _lengths(points: np.ndarray, chosen: np.ndarray) -> np.ndarray:
    """(J, K) lengths of the shortest ways from the chosen points to all, along the object [m]."""
    tree = cKDTree(points)
    distance, index = tree.query(points, k=min(_NEIGHBOURS + 1, len(points)))
    own = np.repeat(np.arange(len(points)), index.shape[1] - 1)
    other, step = index[:, 1:].ravel(), distance[:, 1:].ravel()
    # what is much farther than usual is beyond a gap
    near = step < _GAP * np.median(step)
    rows, columns, steps = [own[near]], [other[near]], [step[near]]
    for _ in range(len(points)):
        graph = _symmetric(rows, columns, steps, len(points))
        number, label = connected_components(graph, directed=False)
        if number == 1:
            break
        # the smallest piece is tied to what is nearest of the others
        piece = int(np.argmin(np.bincount(label)))
        inside, outside = np.flatnonzero(label == piece), np.flatnonzero(label != piece)
        away, nearest = cKDTree(points[outside]).query(points[inside])
        tie = int(np.argmin(away))
        rows.append(inside[tie : tie + 1])
        columns.append(outside[nearest[tie : tie + 1]])
        steps.append(away[tie : tie + 1])
    return dijkstra(graph, directed=False, indices=chosen)


def _symmetric(
    rows: list[np.ndarray], columns: list[np.ndarray], steps: list[np.ndarray], count: int
) -> csr_matrix:
    row, column, step = (np.concatenate(each) for each in (rows, columns, steps))
    # zero is no edge to a sparse matrix
    graph = csr_matrix((np.maximum(step, 1e-12), (row, column)), shape=(count, count))
    return graph.maximum(graph.T)


def _edges(carriers: np.ndarray, count: int) -> np.ndarray:
    """Pairs (E, 2) of nodes that carry a point together, in both orders."""
    pairs = np.concatenate([carriers[:, [a, b]] for a in range(CARRIERS) for b in range(CARRIERS) if a != b])
    key = np.unique(pairs[:, 0].astype(np.int64) * count + pairs[:, 1])
    return np.stack([key // count, key % count], axis=1)
