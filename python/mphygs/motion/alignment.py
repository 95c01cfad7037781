"""Moving control points so that Gaussians, drawn, look like the photographs of one frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from scipy.linalg import cho_factor, cho_solve
from scipy.sparse import csr_matrix

from mphygs.capture.cameras import Camera
from mphygs.capture.views import Photograph
from mphygs.motion.control_graph import CARRIERS, ControlGraph, Pose
from mphygs.motion.sight import Sight, SightRule, sight_of
from mphygs.motion.stiffness import Stiffness, disagreements, turn_and_shift
from mphygs.scene.gaussians import Gaussians
from mphygs.scene.tensor_rotation import quaternion_product

_SOFTNESS = (0.06, 0.1, 0.14, 0.2, 0.28, 0.4)  # [px^2], that are tried


@dataclass(frozen=True)
class AlignmentRule:
    """How Gaussians are aligned with pictures.

    levels: (times smaller, most iterations), coarse to fine; noise: standard deviation of differences of
    colour that are not explained by motion, so large that pixels next to each other count as independent;
    averaging: power of "times smaller" by which it falls; points: most Gaussians that are followed, all are
    drawn; behind: how far behind the drawn surface a Gaussian counts as seen, in distances of control points;
    stop: end of a level, root mean square step of the control points [px].
    """

    levels: tuple[tuple[int, int], ...] = ((8, 3), (4, 3), (2, 2), (1, 2))
    noise: float = 0.15
    averaging: float = 0.75
    points: int = 5000
    behind: float = 0.35
    stop: float = 0.03
    stiffness: Stiffness = Stiffness()
    sight: SightRule = SightRule()

    def __post_init__(self) -> None:
        if not self.levels or any(factor < 1 or count < 1 for factor, count in self.levels):
            raise ValueError(f"levels: {self.levels}; expected pairs of numbers from 1 on")


@dataclass(frozen=True, eq=False)
class Alignment:
    """pose: of the control points; sights: one a camera, of the last iteration."""

    pose: Pose
    sights: tuple[Sight, ...]

    @property
    def difference(self) -> float:
        """Root mean square difference between drawings and photographs, where the object is."""
        return float(np.sqrt(np.mean([sight.difference**2 for sight in self.sights])))


class Aligner:
    """Aligns the same Gaussians with one frame after the other."""

    def __init__(self, gaussians: Gaussians, graph: ControlGraph, rule: AlignmentRule) -> None:
        self.gaussians, self.graph, self.rule = gaussians, graph, rule
        solid = np.flatnonzero(gaussians.opacities.detach().numpy() > 0.1)
        stride = max(1, -(-len(solid) // rule.points))
        self.chosen = solid[::stride]

    def drawn(self, pose: Pose) -> Gaussians:
        """The Gaussians carried by control points in `pose`."""
        dtype = self.gaussians.positions.dtype
        return replace(
            self.gaussians,
            positions=torch.as_tensor(self.graph.carried(pose), dtype=dtype),
            rotations=quaternion_product(
                torch.as_tensor(self.graph.turns(pose), dtype=dtype), self.gaussians.rotations
            ),
        )

    def matched(self, photographs: Sequence[Photograph], pose: Pose) -> Aligner:
        """The same with drawings as soft as photographs that show the Gaussians in about this pose.

        Edges drawn softer or sharper than they are pull the Gaussians inward or outward.
        """
        found, least = self, np.inf
        for softness in _SOFTNESS:
            rule = replace(self.rule, sight=replace(self.rule.sight, softness=softness))
            tried = Aligner(self.gaussians, self.graph, rule)
            alignment = tried.align(photographs, pose, levels=((1, 2),))
            if alignment.difference < least:
                found, least = tried, alignment.difference
        return found

    def align(
        self,
        photographs: Sequence[Photograph],
        expected: Pose,
        *,
        start: Pose | None = None,
        levels: Sequence[tuple[int, int]] | None = None,
        features: Sequence[np.ndarray] | None = None,
    ) -> Alignment:
        """The pose near `start` in which the Gaussians look like the photographs, one a camera.

        expected: of the control points, before the pictures are looked at; start: where to begin, `expected`
        for None; levels: other ones than the rule's; features: (H, W, F) a photograph.
        """
        pose = expected if start is None else start
        for factor, iterations in self.rule.levels if levels is None else levels:
            for _ in range(iterations):
                last = self._sights(pose, photographs, factor, features)
                hessian, slope = self._normal_equations(pose, expected, last)
                step = cho_solve(cho_factor(hessian, lower=True, check_finite=False), slope)
                pose = pose.moved(step.reshape(-1, 6))
                moved = np.sqrt((step.reshape(-1, 6)[:, 3:] ** 2).sum(axis=1).mean())
                middle = self.graph.nodes.mean(axis=0)
                if moved * max(pixels_per_metre(s.camera, middle) for s in last) < self.rule.stop:
                    break
        return Alignment(pose, tuple(last))

    def _sights(
        self,
        pose: Pose,
        photographs: Sequence[Photograph],
        factor: int,
        features: Sequence[np.ndarray] | None,
    ) -> list[Sight]:
        gaussians, points = self.drawn(pose), self.graph.carried(pose, self.chosen)
        return [
            sight_of(
                gaussians,
                points,
                photograph,
                behind=self.rule.behind * self.graph.spacing,
                factor=factor,
                noise=self.rule.noise / factor**self.rule.averaging,
                rule=self.rule.sight,
                features=None if features is None else features[index],
            )
            for index, photograph in enumerate(photographs)
        ]

    def _normal_equations(
        self, pose: Pose, expected: Pose, sights: Sequence[Sight]
    ) -> tuple[np.ndarray, np.ndarray]:
        """H (6J, 6J) and g (6J,) of the step H^-1 g of Gauss and Newton."""
        points = self.graph.carried(pose, self.chosen)
        information, pull = combined_sights(points, sights)
        hessian, slope = self._of_points(pose, information, pull)
        for rows, residual in disagreements(self.graph, pose, expected, self.rule.stiffness):
            hessian += (rows.T @ rows).toarray()
            slope -= rows.T @ residual
        return hessian, slope

    def _of_points(
        self, pose: Pose, information: np.ndarray, pull: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """The share of the pictures: points' information (N, 3, 3) and pull (N, 3) on the control points."""
        told = np.flatnonzero(np.trace(information, axis1=1, axis2=2) > 0)
        chosen = self.chosen[told]
        by_node = self.graph.weights[chosen, :, None, None] * turn_and_shift(self.graph.arms(pose, chosen))
        value, vector = np.linalg.eigh(information[told])
        root = np.sqrt(np.maximum(value, 0.0))[:, :, None] * vector.transpose(0, 2, 1)
        blocks = np.einsum("nab,ncbd->nacd", root, by_node)  # (N, 3, 4, 6)
        column = (6 * self.graph.carriers[chosen][:, :, None] + np.arange(6)).reshape(len(told), 1, -1)
        columns = np.broadcast_to(column, (len(told), 3, 6 * CARRIERS)).ravel()
        starts = np.arange(3 * len(told) + 1) * 6 * CARRIERS
        size = 6 * len(self.graph.nodes)
        rows = csr_matrix((blocks.ravel(), columns, starts), shape=(3 * len(told), size))
        dense = np.zeros((size, size))
        dense += (rows.T @ rows).toarray()
        force = np.einsum("nabd,nb->nad", by_node, pull[told])
        slope = np.bincount(column.ravel(), force.ravel(), minlength=size)
        return dense, slope


def combined_sights(points: np.ndarray, sights: Sequence[Sight]) -> tuple[np.ndarray, np.ndarray]:
    """Information (N, 3, 3) [1/m^2] and pull (N, 3) [1/m] of all cameras together on points (N, 3) [m]."""
    information, pull = np.zeros((len(points), 3, 3)), np.zeros((len(points), 3))
    for sight in sights:
        jacobian = projection_jacobian(sight.camera, points)
        information += np.einsum("nia,nij,njb->nab", jacobian, sight.information, jacobian)
        pull += np.einsum("nia,ni->na", jacobian, sight.pull)
    return information, pull


def pixels_per_metre(camera: Camera, point: np.ndarray) -> float:
    """Scale [px/m] of the picture at a point (3,) [m]."""
    return float(camera.focal[0] / max(camera.project(point[None])[1][0], 1e-6))


def projection_jacobian(camera: Camera, points: np.ndarray) -> np.ndarray:
    """Derivative (N, 2, 3) [px/m] of the pixel of points (N, 3) [m] in front of the camera."""
    rotation = camera.camera_from_world[:3, :3]
    own = points @ rotation.T + camera.camera_from_world[:3, 3]
    depth = np.where(own[:, 2] > 0, own[:, 2], np.inf)
    jacobian = np.zeros((len(points), 2, 3))
    jacobian[:, 0, 0], jacobian[:, 1, 1] = camera.focal[0] / depth, camera.focal[1] / depth
    jacobian[:, :, 2] = -camera.focal * own[:, :2] / depth[:, None] ** 2
    return jacobian @ rotation
