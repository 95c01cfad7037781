"""How the place where the object is held moves: the rigid motion that the tracks about it share.

Minimised over the place xc(t) and the turn R(t), quaternion qc(t), of the contact:

    sum_t |xc - xc_coarse|^2 + sum_t sum_i |xc(t) + R(t) (X_i - Xc) - x_i(t)|^2
        + 0.1 sum_t |second difference of xc|^2 + 1e-4 sum_t |second difference of qc|^2

as in M-PhyGs. X_i are places at rest and Xc that of the contact, where the paper has frame 1: a hold is told
relative to rest, and the noise of one frame is in no other.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.linalg import solveh_banded

from mphygs.capture.cameras import Camera
from mphygs.capture.errors import fault
from mphygs.capture.rotation import (
    align_rigid,
    matrix_from_quaternion,
    quaternion_by_turn,
    quaternion_from_matrix,
    quaternion_from_rotation_vector,
    sign_continuous,
)
from mphygs.motion.stiffness import turn_and_shift
from mphygs.scene.agreement import triangulate

LEAST_TRACKS = 6
_BAND = 18  # three frames of six unknowns


@dataclass(frozen=True)
class ContactWeights:
    """Of the four sums; those of the method."""

    coarse: float = 1.0
    tracks: float = 1.0
    place: float = 0.1
    turn: float = 1e-4


@dataclass(frozen=True, eq=False)
class ContactMotion:
    """place: (T, 3) [m], of the contact; turn: (T, 3, 3), from rest; at: (3,) [m], the contact at rest;
    residual: (T, N) [m], of the tracks about it, NaN where there was none; costs: after every iteration."""

    place: np.ndarray
    turn: np.ndarray
    at: np.ndarray
    residual: np.ndarray
    costs: tuple[float, ...]

    @property
    def position(self) -> np.ndarray:
        """(T, 3) [m], the p of x = R X + p, as a hold has it."""
        return self.place - self.turn @ self.at

    @property
    def quaternion(self) -> np.ndarray:
        """(T, 4) wxyz, of one continuous choice of sign."""
        return sign_continuous(quaternion_from_matrix(self.turn))


def coarse_contact(
    cameras: Mapping[str, Camera], contact: Mapping[str, Mapping[int, np.ndarray]], frames: int
) -> np.ndarray:
    """The contact (T, 3) [m] triangulated in the frames where two cameras or more have it, NaN in others.

    contact: camera -> frame -> pixel (2,), undistorted. Raises CaptureError where no frame has it twice.
    """
    place = np.full((frames, 3), np.nan)
    for frame in range(frames):
        seen = [name for name in cameras if frame in contact.get(name, {})]
        if len(seen) >= 2:
            place[frame] = triangulate(
                [cameras[name] for name in seen], np.array([contact[name][frame] for name in seen])
            )
    if np.isnan(place).all():
        raise fault("contact.json", "shows the contact nowhere in two cameras", "two pixels in some frame")
    return place


def fit_contact(
    rest: np.ndarray,
    tracks: np.ndarray,
    coarse: np.ndarray,
    at: np.ndarray,
    *,
    weights: ContactWeights | None = None,
    trust: np.ndarray | None = None,
    iterations: int = 50,
) -> ContactMotion:
    """The motion of the contact from tracks about it, by Gauss and Newton.

    rest: (N, 3) [m]; tracks: (T, N, 3) [m], NaN where a track was not seen; coarse: (T, 3) [m], NaN where
    the contact was not pointed at; at: (3,) [m], of the contact at rest; trust: (T, N), of each track, 1 for
    None. Begins with the rigid motion (Kabsch) of each frame. Raises ValueError for fewer than six tracks or
    a frame without three of them.
    """
    weights = weights or ContactWeights()
    known = np.isfinite(tracks).all(axis=2)
    share = known.astype(float) if trust is None else np.where(known, trust, 0.0)
    if len(rest) < LEAST_TRACKS or known.sum(axis=1).min() < 3:
        frame = int(np.argmin(known.sum(axis=1)))
        raise ValueError(
            f"frame {frame}: {known[frame].sum()} of {len(rest)} tracks about the contact are seen; expected "
            f"at least 3 in every frame, of at least {LEAST_TRACKS}"
        )
    arms = rest - at
    where = np.where(known[..., None], tracks, 0.0)
    turn = np.stack([align_rigid(rest[k], x[k])[0] for k, x in zip(known, where, strict=True)])
    mean = share.sum(axis=1, keepdims=True)
    place = ((where - arms @ turn.transpose(0, 2, 1)) * share[..., None]).sum(axis=1) / mean
    costs: list[float] = []
    for _ in range(iterations):
        cost, hessian, slope = _normal_equations(place, turn, arms, where, share, coarse, weights)
        costs.append(cost)
        if len(costs) > 1 and costs[-2] - cost < 1e-10 * cost:
            break
        step = solveh_banded(hessian, -slope, lower=True).reshape(-1, 6)
        place = place + step[:, 3:]
        turn = matrix_from_quaternion(quaternion_from_rotation_vector(step[:, :3])) @ turn
    away = np.linalg.norm(place[:, None] + arms @ turn.transpose(0, 2, 1) - where, axis=2)
    return ContactMotion(place, turn, at, np.where(known, away, np.nan), tuple(costs))


def _normal_equations(
    place: np.ndarray,
    turn: np.ndarray,
    arms: np.ndarray,
    tracks: np.ndarray,
    share: np.ndarray,
    coarse: np.ndarray,
    weights: ContactWeights,
) -> tuple[float, np.ndarray, np.ndarray]:
    """Half the cost, its Hessian (18, 6T) as lower bands, its slope (6T,): turn, then shift of each frame."""
    frames = len(place)
    blocks = np.zeros((3, frames, 6, 6))  # of frame t with t, t + 1 and t + 2
    slope = np.zeros((frames, 6))
    turned = arms @ turn.transpose(0, 2, 1)
    residual = place[:, None] + turned - tracks
    weight = weights.tracks * share
    cost = 0.5 * float((weight * (residual**2).sum(axis=2)).sum())
    jacobian = turn_and_shift(turned)
    blocks[0] += np.einsum("tn,tnia,tnib->tab", weight, jacobian, jacobian)
    slope += np.einsum("tn,tnia,tni->ta", weight, jacobian, residual)
    off = np.where(np.isfinite(coarse), place - coarse, 0.0)
    cost += 0.5 * weights.coarse * float((off**2).sum())
    blocks[0][:, [3, 4, 5], [3, 4, 5]] += weights.coarse * np.isfinite(coarse)
    slope[:, 3:] += weights.coarse * off
    quaternion = sign_continuous(quaternion_from_matrix(turn))
    shift = np.concatenate([np.zeros((frames, 3, 3)), np.tile(np.eye(3), (frames, 1, 1))], axis=2)
    spin = np.concatenate([quaternion_by_turn(quaternion), np.zeros((frames, 4, 3))], axis=2)
    for values, rows, factor in ((place, shift, weights.place), (quaternion, spin, weights.turn)):
        second = values[:-2] - 2 * values[1:-1] + values[2:]
        cost += 0.5 * factor * float((second**2).sum())
        share_of = (1.0, -2.0, 1.0)
        for a in range(3):
            here = rows[a : frames - 2 + a]
            slope[a : frames - 2 + a] += factor * share_of[a] * np.einsum("tia,ti->ta", here, second)
            for b in range(a, 3):
                there = rows[b : frames - 2 + b]
                product = np.einsum("tia,tib->tab", here, there)
                blocks[b - a][a : frames - 2 + a] += factor * share_of[a] * share_of[b] * product
    return cost, _bands(blocks), slope.ravel()


def _bands(blocks: np.ndarray) -> np.ndarray:
    """Lower bands (18, 6T) of a symmetric matrix from its blocks (3, T, 6, 6) of t with t, t + 1, t + 2."""
    frames = blocks.shape[1]
    bands = np.zeros((_BAND, 6 * frames))
    for apart in range(3):
        for a in range(6):
            for b in range(6):
                row = 6 * apart + b - a
                if row >= 0:
                    bands[row, a::6] += blocks[apart, :, a, b]
    return bands
