"""The rigid motion that brings the object at rest to frame 0: by points pointed at, then by the pictures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from mphygs.capture.annotations import Correspondence
from mphygs.capture.cameras import Camera
from mphygs.capture.rotation import align_rigid, matrix_from_rotation_vector, quaternion_from_matrix
from mphygs.capture.views import Photograph
from mphygs.motion.alignment import AlignmentRule, combined_sights, pixels_per_metre
from mphygs.motion.sight import sight_of
from mphygs.motion.stiffness import turn_and_shift
from mphygs.render.picture import Optics
from mphygs.render.splatting import splat
from mphygs.scene.agreement import triangulate
from mphygs.scene.gaussians import Gaussians
from mphygs.scene.tensor_rotation import quaternion_product

_TRIPLES = 500  # most that are tried
_FAR = 3.0  # times the usual distance; what is farther off does not count
_SEARCHED = 48  # pixels along the longer side of the pictures that are searched
_REFINED = 4  # of the poses searched
_PATIENCE = 4  # times the rule's iterations of a level, at most
_BEHIND = 0.02  # of the object's extent: so far behind what is drawn a Gaussian is still seen


@dataclass(frozen=True, eq=False)
class RigidMotion:
    """x = rotation X + shift. rotation: (3, 3); shift: (3,) [m]."""

    rotation: np.ndarray
    shift: np.ndarray

    def of(self, points: np.ndarray) -> np.ndarray:
        """Points (N, 3) [m] after the motion."""
        return points @ self.rotation.T + self.shift

    def of_gaussians(self, gaussians: Gaussians) -> Gaussians:
        """Gaussians after the motion; harmonics above degree 0 are not turned."""
        dtype = gaussians.positions.dtype
        turn = torch.as_tensor(quaternion_from_matrix(self.rotation), dtype=dtype)
        places = self.of(gaussians.positions.detach().numpy().astype(np.float64))
        return replace(
            gaussians,
            positions=torch.as_tensor(places, dtype=dtype),
            rotations=quaternion_product(turn, gaussians.rotations),
        )


def pointed_at(
    correspondences: Sequence[Correspondence], rest: Mapping[str, Camera], first: Mapping[str, Camera]
) -> tuple[np.ndarray, np.ndarray]:
    """The points at rest and in frame 0, (N, 3) [m] each, triangulated.

    rest, first: cameras by name. Raises ValueError where lines of sight are parallel.
    """
    places = []
    for side, cameras in (("rest", rest), ("first", first)):
        pixels = [getattr(c, side) for c in correspondences]
        places.append([triangulate([cameras[n] for n in p], np.array(list(p.values()))) for p in pixels])
    return np.array(places[0]).reshape(-1, 3), np.array(places[1]).reshape(-1, 3)


def robust_rigid(source: np.ndarray, target: np.ndarray) -> tuple[RigidMotion, np.ndarray]:
    """The rigid motion most of the points agree on, and which of them do (N,).

    source, target: (N, 3) [m]. Of the motions of triples the one of least median distance; then Kabsch's of
    all points within three times the usual distance of it, until these stay the same. Raises ValueError where
    no three points fix a rotation.
    """
    triples = list(combinations(range(len(source)), 3))
    best, least = None, np.inf
    for triple in triples[:: max(1, len(triples) // _TRIPLES)]:
        try:
            motion = RigidMotion(*align_rigid(source[list(triple)], target[list(triple)]))
        except ValueError:  # the three lie on one line
            continue
        middle = float(np.median(np.linalg.norm(motion.of(source) - target, axis=1)))
        if middle < least:
            best, least = motion, middle
    if best is None:
        raise ValueError(f"{len(source)} points do not fix a rotation; expected three that are not on a line")
    agree = np.zeros(len(source), dtype=bool)
    for _ in range(20):
        away = np.linalg.norm(best.of(source) - target, axis=1)
        # 1.54 medians of the length of a Gaussian vector are its standard deviation a coordinate times 2.37
        now = away <= _FAR * max(1.5 * float(np.median(away)), 1e-9)
        if (now == agree).all():
            break
        agree = now
        best = RigidMotion(*align_rigid(source[agree], target[agree]))
    return best, agree


def refined_rigid(
    gaussians: Gaussians,
    photographs: Sequence[Photograph],
    start: RigidMotion,
    rule: AlignmentRule,
) -> RigidMotion:
    """The rigid motion near `start` after which the Gaussians look like the photographs (Gauss-Newton).

    A level ends where the points move by less than the rule's `stop`.
    """
    motion = start
    rest = gaussians.positions.detach().numpy().astype(np.float64)
    chosen = np.flatnonzero(gaussians.opacities.detach().numpy() > 0.1)
    chosen = chosen[:: max(1, -(-len(chosen) // rule.points))]
    behind = _BEHIND * float(np.linalg.norm(np.ptp(rest[chosen], axis=0)))
    for factor, iterations in rule.levels:
        for _ in range(_PATIENCE * iterations):
            drawn, points = motion.of_gaussians(gaussians), motion.of(rest[chosen])
            noise = rule.noise / factor**rule.averaging
            sights = [
                sight_of(drawn, points, p, behind=behind, factor=factor, noise=noise, rule=rule.sight)
                for p in photographs
            ]
            information, pull = combined_sights(points, sights)
            middle = points.mean(axis=0)
            rows = turn_and_shift(points - middle)
            hessian = np.einsum("nia,nij,njb->ab", rows, information, rows)
            slope = np.einsum("nia,ni->a", rows, pull)
            # what no picture tells stays
            hessian += 1e-6 * np.diag(np.diag(hessian)) + 1e-9 * np.eye(6)
            step = np.linalg.solve(hessian, slope)
            turn = matrix_from_rotation_vector(step[:3])
            shift = turn @ (motion.shift - middle) + middle + step[3:]
            motion = RigidMotion(turn @ motion.rotation, shift)
            moved = np.sqrt(((rows @ step) ** 2).sum(axis=1).mean())
            if moved * max(pixels_per_metre(sight.camera, middle) for sight in sights) < rule.stop:
                break
    return motion


def found_rigid(gaussians: Gaussians, photographs: Sequence[Photograph], rule: AlignmentRule) -> RigidMotion:
    """The rigid motion of frame 0 where nobody pointed at anything: the best of many, refined.

    Tried are no motion at all, and the shift of the silhouettes' middles with 24 + 1 turns about the object's
    middle; they are compared in small pictures by colour and silhouette.
    """
    small = [p.shrunk(max(1, max(p.mask.shape) // _SEARCHED)) for p in photographs]
    rest = gaussians.positions.detach().numpy().astype(np.float64)
    weight = gaussians.opacities.detach().numpy()
    middle = np.average(rest, axis=0, weights=weight)
    target = triangulate([p.camera for p in small], np.array([_middle(p.mask) for p in small]))
    tried = [RigidMotion(np.eye(3), np.zeros(3))]
    for turn in Rotation.create_group("O").as_matrix():
        tried.append(RigidMotion(turn, target - turn @ middle))
    unlike = [unlikeness(motion.of_gaussians(gaussians), small) for motion in tried]
    best = [tried[k] for k in np.argsort(unlike, kind="stable")[:_REFINED]]
    coarse = replace(rule, levels=tuple(level for level in rule.levels if level[0] > 1) or rule.levels)
    near = [refined_rigid(gaussians, photographs, motion, coarse) for motion in best]
    unlike = [unlikeness(motion.of_gaussians(gaussians), small) for motion in near]
    return refined_rigid(gaussians, photographs, near[int(np.argmin(unlike))], rule)


def _middle(mask: np.ndarray) -> np.ndarray:
    # of a small picture of something thin no pixel may be covered by half
    row, column = np.nonzero(mask >= 0.5 * mask.max())
    return np.array([column.mean(), row.mean()]) + 0.5


def unlikeness(gaussians: Gaussians, photographs: Sequence[Photograph], *, softness: float = 0.3) -> float:
    """Mean absolute difference of colours and silhouettes over all pixels.

    softness: of the drawing, as Optics.blur [px^2].
    """
    total = 0.0
    with torch.no_grad():
        for photograph in photographs:
            picture = splat(gaussians, photograph.camera, optics=Optics(blur=softness))
            colour = photograph.colour * photograph.mask[..., None]
            total += float(np.abs(picture.colour.numpy() - colour).mean())
            total += float(np.abs(picture.opacity.numpy() - photograph.mask).mean())
    return total / len(photographs)
