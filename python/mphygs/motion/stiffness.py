"""What is expected of control points beside the pictures: neighbours move alike, and much as a moment ago.

Local rigidity and similarity of rotations, against the shape at rest (which keeps lengths) and against the
motion that was expected: the penalties of Dynamic 3D Gaussians (Luiten et al. 2024), on control points, as
sums of squares.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix

from mphygs.capture.rotation import rotation_vector_from_matrix
from mphygs.motion.control_graph import ControlGraph, Pose


@dataclass(frozen=True)
class Stiffness:
    """Standard deviations of how far neighbouring control points may disagree, in their mean distance.

    rigidity: of their distance vectors from those at rest, turned; similarity: of their turns, times the
    distance; step: of either against the motion that was expected; place: of a control point from where it
    was expected.
    """

    rigidity: float = 0.04
    similarity: float = 0.14
    step: float = 0.03
    place: float = 7.0

    def __post_init__(self) -> None:
        if min(self.rigidity, self.similarity, self.step, self.place) <= 0:
            raise ValueError(f"{self}: expected every number above zero")

    def times(self, factor: float) -> Stiffness:
        """All standard deviations `factor` times as large."""
        return Stiffness(
            factor * self.rigidity, factor * self.similarity, factor * self.step, factor * self.place
        )


def disagreements(
    graph: ControlGraph, pose: Pose, expected: Pose, stiffness: Stiffness
) -> list[tuple[csr_matrix, np.ndarray]]:
    """Jacobians and residuals, in standard deviations, of what is expected of control points."""
    edge = graph.nodes[graph.edges[:, 1]] - graph.nodes[graph.edges[:, 0]]
    length = np.linalg.norm(edge, axis=1)
    first, second = graph.edges.T
    turned = np.einsum("eij,ej->ei", pose.rotation[first], edge)
    way = pose.position[second] - pose.position[first]
    rigid = _edge_rows(graph, turned)
    similar = _turn_rows(graph, length)
    # turns of neighbours, and of the step against the expected one, as rotation vectors in world axes
    apart = rotation_vector_from_matrix(
        np.einsum("eij,ekj->eik", pose.rotation[second], pose.rotation[first])
    )
    step = rotation_vector_from_matrix(np.einsum("jik,jlk->jil", pose.rotation, expected.rotation))
    expected_way = expected.position[second] - expected.position[first]
    carried = np.einsum("eij,ekj->eik", pose.rotation[first], expected.rotation[first])
    expected_way = np.einsum("eij,ej->ei", carried, expected_way)
    rigidity, similarity, by_step, by_place = (
        graph.spacing * getattr(stiffness, name) for name in ("rigidity", "similarity", "step", "place")
    )
    step_bend = (step[second] - step[first]) * length[:, None]
    place = np.concatenate([graph.spacing * step, pose.position - expected.position], axis=1)
    count = 6 * len(graph.nodes)
    scale = np.tile(np.repeat([graph.spacing, 1.0], 3), len(graph.nodes)) / by_place
    diagonal = csr_matrix((scale, np.arange(count), np.arange(count + 1)), shape=(count, count))
    return [
        (rigid / rigidity, (turned - way).ravel() / rigidity),
        (similar / similarity, (apart * length[:, None]).ravel() / similarity),
        (_edge_rows(graph, expected_way) / by_step, (expected_way - way).ravel() / by_step),
        (similar / by_step, step_bend.ravel() / by_step),
        (diagonal, place.ravel() / by_place),
    ]


def turn_and_shift(arms: np.ndarray) -> np.ndarray:
    """Derivative (..., 3, 6) of a point at `arms` (..., 3) [m] from its node by the node's turn and shift."""
    blocks = np.zeros((*arms.shape[:-1], 3, 6))
    x, y, z = np.moveaxis(arms, -1, 0)
    blocks[..., 0, 1], blocks[..., 0, 2] = z, -y
    blocks[..., 1, 0], blocks[..., 1, 2] = -z, x
    blocks[..., 2, 0], blocks[..., 2, 1] = y, -x
    blocks[..., [0, 1, 2], [3, 4, 5]] = 1.0
    return blocks


def _edge_rows(graph: ControlGraph, way: np.ndarray) -> csr_matrix:
    """Derivative (3E, 6J) of `way` (E, 3) turned with its first node, less the way between the nodes."""
    first, second = graph.edges.T
    own = turn_and_shift(way)  # shift of the first node counts +, of the second -
    other = np.zeros((len(way), 3, 6))
    other[:, [0, 1, 2], [3, 4, 5]] = -1.0
    return _rows(graph, first, second, own, other)


def _turn_rows(graph: ControlGraph, length: np.ndarray) -> csr_matrix:
    """Derivative (3E, 6J) of the turn of the second node less that of the first, times `length` (E,) [m]."""
    first, second = graph.edges.T
    own, other = np.zeros((len(length), 3, 6)), np.zeros((len(length), 3, 6))
    own[:, [0, 1, 2], [0, 1, 2]] = -length[:, None]
    other[:, [0, 1, 2], [0, 1, 2]] = length[:, None]
    return _rows(graph, first, second, own, other)


def _rows(
    graph: ControlGraph,
    first: np.ndarray,
    second: np.ndarray,
    first_block: np.ndarray,
    second_block: np.ndarray,
) -> csr_matrix:
    """Sparse rows of two blocks (E, 3, 6), of the nodes first and second (E,)."""
    blocks = np.stack([first_block, second_block], axis=2)  # (E, 3, 2, 6)
    column = 6 * np.stack([first, second], axis=1)[:, None, :, None] + np.arange(6)
    columns = np.broadcast_to(column, blocks.shape).ravel()
    starts = np.arange(3 * len(first) + 1) * 12
    shape = (3 * len(first), 6 * len(graph.nodes))
    return csr_matrix((blocks.ravel(), columns, starts), shape=shape)
