"""What a hand holds, from tracks and pixels at which it was pointed at: which points move as one, and how."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from mphygs.capture.rotation import align_rigid
from mphygs.motion.contact_motion import LEAST_TRACKS, ContactMotion, ContactWeights, fit_contact

CORE = 16  # tracks nearest to the contact that surely move with it
_RADIUS = 0.06  # of the object's extent: tracks that near are of the core as well
_WINDOW = 15  # tracks of about the same distance from the contact
# Times the residual of the core, from which tracks are off its rigid motion: all about them, and one alone.
_OFF, _ALONE = 2.0, 3.0
_ROUNDS = 3


@dataclass(frozen=True, eq=False)
class Grip:
    """motion: of the held points; held: (n,) indices of their tracks; box: (2, 3) [m], where they stand at
    rest; residual: root mean square distance a coordinate of their tracks from it [m]."""

    motion: ContactMotion
    held: np.ndarray
    box: np.ndarray
    residual: float


def contact_at_rest(rest: np.ndarray, tracks: np.ndarray, coarse: np.ndarray) -> np.ndarray:
    """Where the contact is on the object at rest, (3,) [m].

    rest: (M, 3); tracks: (T, M, 3), NaN where not seen; coarse: (T, 3), the contact, NaN where nobody pointed
    at it. In each frame the tracks nearest to the contact carry it back (Kabsch); the median over frames.
    Raises ValueError where no frame has both.
    """
    found = []
    for places, contact in zip(tracks, coarse, strict=True):
        seen = np.flatnonzero(np.isfinite(places).all(axis=1))
        if np.isnan(contact).any() or len(seen) < CORE:
            continue
        near = seen[np.argsort(np.linalg.norm(places[seen] - contact, axis=1), kind="stable")[:CORE]]
        try:
            rotation, shift = align_rigid(places[near], rest[near])
        except ValueError:  # those are on one line
            continue
        found.append(rotation @ contact + shift)
    if not found:
        raise ValueError(f"no frame has the contact and {CORE} tracks; expected one at least")
    return np.median(found, axis=0)


def find_grip(
    rest: np.ndarray,
    tracks: np.ndarray,
    coarse: np.ndarray,
    *,
    radius: float | None = None,
    weights: ContactWeights | None = None,
) -> Grip:
    """The points about the contact that move as one, and their motion.

    rest: (M, 3) [m]; tracks: (T, M, 3) [m], NaN where not seen; coarse: (T, 3) [m], NaN where nobody pointed
    at the contact; radius: of the held points about the contact [m]; None: from those nearest to it outward,
    until they are off the rigid motion by more than twice what the nearest are. Raises ValueError for fewer
    tracks than that takes, and for a radius within which there are too few.
    """
    if len(rest) < CORE:
        raise ValueError(f"{len(rest)} tracks; expected at least {CORE}")
    at = contact_at_rest(rest, tracks, coarse)
    distance = np.linalg.norm(rest - at, axis=1)
    order = np.argsort(distance, kind="stable")
    if radius is None:
        near = _RADIUS * float(np.linalg.norm(np.ptp(rest, axis=0)))
        held = order[: max(CORE, int((distance <= near).sum()))]
    else:
        held = order[: int((distance <= radius).sum())]
        if len(held) < LEAST_TRACKS:
            raise ValueError(
                f"{len(held)} tracks within {radius:g} m of the contact; expected at least {LEAST_TRACKS}"
            )
    trust = np.ones((len(tracks), len(held)))
    for _ in range(_ROUNDS):
        motion = fit_contact(rest[held], tracks[:, held], coarse, at, weights=weights, trust=trust)
        usual = float(np.nanmedian(motion.residual))
        if radius is None:
            held = _moving_with(rest, tracks, motion, order)
        trust = 1.0 / (1.0 + (_residual(rest, tracks, motion)[:, held] / (_ALONE * usual + 1e-12)) ** 2) ** 2
        trust[~np.isfinite(trust)] = 0.0
    motion = fit_contact(rest[held], tracks[:, held], coarse, at, weights=weights, trust=trust)
    # half of what a track stands for to every side
    margin = 0.5 * float(np.median(cKDTree(rest).query(rest, k=2)[0][:, 1]))
    box = np.stack([rest[held].min(axis=0) - margin, rest[held].max(axis=0) + margin])
    rms = float(np.sqrt(np.nanmean(motion.residual**2) / 3.0))
    return Grip(motion, held, box, rms)


def _residual(rest: np.ndarray, tracks: np.ndarray, motion: ContactMotion) -> np.ndarray:
    """(T, M) distances of all tracks from the rigid motion [m], NaN where not seen."""
    carried = rest @ motion.turn.transpose(0, 2, 1) + motion.position[:, None]
    return np.linalg.norm(carried - tracks, axis=2)


def _moving_with(
    rest: np.ndarray, tracks: np.ndarray, motion: ContactMotion, order: np.ndarray
) -> np.ndarray:
    """Indices of the tracks that move with the contact; order: all, the nearest to it at rest first."""
    away = _residual(rest, tracks, motion)[:, order]
    seen = np.isfinite(away)
    mean = np.sqrt((np.where(seen, away, 0.0) ** 2).sum(axis=0) / np.maximum(seen.sum(axis=0), 1))
    usual = float(np.median(mean[:CORE]))
    ends = np.arange(CORE, len(order))
    windows = np.array([np.median(mean[max(0, end - _WINDOW) : end]) for end in ends])
    off = np.flatnonzero(windows > _OFF * usual)
    end = int(ends[off[0]]) - _WINDOW // 2 if len(off) else len(order)
    within = np.arange(max(end, CORE))
    return order[within[(mean[within] <= _ALONE * usual) | (within < CORE)]]
