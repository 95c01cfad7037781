"""Motions packed for a page: shapes as a few modes over time, measurements as 16-bit numbers, in base64."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence

import numpy as np

from mphygs.report.skin import Skin

# Frames that a page carries of one sequence; longer ones are thinned out.
LARGEST_FRAME_COUNT = 200
# Bytes of one motion, and the share of them that measurements and errors may take.
BUDGET, MEASURED_SHARE = 600_000, 0.5
# How far modes may be off a shape, beside its extent.
TOLERANCE = 1e-4
# Of the longest arrow, beside the extent of the motion.
ARROW = 0.15
# The 16-bit number of a value that was not measured, and the largest that is one.
MISSING, LARGEST = -32768, 32767

Force = tuple[np.ndarray, np.ndarray, np.ndarray]


def encoded(values: np.ndarray, kind: str) -> str:
    """Numbers as base64 of a little-endian kind."""
    return base64.b64encode(np.ascontiguousarray(values).astype(kind).tobytes()).decode("ascii")


def quantise(values: np.ndarray, low: np.ndarray, high: np.ndarray) -> str:
    """Positions (..., 3) [m] in the box low to high as little-endian int16 in base64; NaN is MISSING."""
    span = np.where(high > low, high - low, 1.0)
    scaled = np.rint((values - low) / span * 2.0 * LARGEST - LARGEST)
    whole = np.where(np.isfinite(scaled), np.clip(scaled, -LARGEST, LARGEST), MISSING)
    return encoded(whole, "<i2")


def modes_of(
    motion: np.ndarray, box: tuple[np.ndarray, np.ndarray], tolerance: float, largest: int
) -> dict[str, object]:
    """A motion (T, N, 3) [m] as its mean and a few modes times amplitudes (singular value decomposition).

    As many modes as leave nowhere more than tolerance [m], at most `largest`. box: low and high [m].
    """
    flat = motion.reshape(len(motion), -1)
    mean = flat.mean(0)
    left, size, right = np.linalg.svd(flat - mean, full_matrices=False)
    rest, rank = flat - mean, 0
    while rank < min(largest, len(size)) and np.abs(rest).max() > tolerance:
        rest = rest - np.outer(left[:, rank] * size[rank], right[rank])
        rank += 1
    peak = np.abs(right[:rank]).max(1) if rank else np.zeros(0)
    return {
        "mean": quantise(mean.reshape(-1, 3), *box),
        "count": rank,
        "modes": encoded(np.rint(right[:rank] / peak[:, None] * LARGEST), "<i2"),
        "amplitudes": encoded(left[:, :rank] * size[:rank] * peak / LARGEST, "<f4"),
    }


def skin_document(skin: Skin, parts: Sequence[str]) -> dict[str, object]:
    """The mesh of a page. parts: names."""
    wide = len(skin.points) >= 65536
    return {
        "faces": encoded(skin.faces, "<u4" if wide else "<u2"),
        "wide": wide,
        "part": skin.part.tolist(),
        "parts": list(parts),
    }


def markers_document(
    near: np.ndarray, weight: np.ndarray, labels: Sequence[str], order: Sequence[int]
) -> dict[str, object]:
    """A sequence's markers beside the skin. near, weight: see `nearest_markers`; order: to show them in."""
    return {
        "near": encoded(near, "<u2"),
        "weight": encoded(np.rint(255 * weight), "<u1"),
        "neighbours": near.shape[1],
        "labels": list(labels),
        "order": list(order),
    }


def motion_document(
    *,
    fps: float,
    measured: np.ndarray,
    models: Mapping[str, np.ndarray],
    fit: tuple[int, int],
    sigma: float,
    force: Force | None = None,
    budget: int = BUDGET,
) -> dict[str, object]:
    """One sequence for the page.

    measured: (T, M, 3) [m]; models: label -> (T, M + V, 3) [m], its prediction of markers and, behind them,
    of the skin; fit: frames fitted; sigma: of the noise [m]; force: frames (K,), places (K, C, 3) [m] and
    missing force (K, C, 3) [N/kg] there; budget: bytes, kept by showing fewer frames and modes. Raises
    ValueError where the shapes do not belong together.
    """
    frames, markers = measured.shape[:2]
    for label, points in models.items():
        if len(points) != frames or points.shape[1] < markers:
            raise ValueError(f"motion: measured {measured.shape}, predicted by {label} {points.shape}")
    # What a shape takes without any mode, and what tells its skin from which markers it is painted.
    budget -= max(points.shape[1] for points in models.values()) * (6 * len(models) + 18)
    each = max(markers * (6 + 4 * len(models)), 1)
    most = min(LARGEST_FRAME_COUNT, max(int(MEASURED_SHARE * budget / each), 20))
    shown = np.arange(0, frames, max(1, -(-frames // most)))
    everything = np.concatenate([points[shown].reshape(-1, 3) for points in models.values()])
    extent = float(np.ptp(everything, axis=0).max())
    arrows = None
    if force is not None:
        arrows = _arrows(force, frames, extent)[shown]
        ends = arrows.reshape(-1, 3)
        everything = np.concatenate([everything, ends[np.isfinite(ends).all(1)]])
    rank = _rank(next(iter(models.values())), len(models), budget)
    # A measurement is shown where it is as far as the object's size from all that is predicted; one that is
    # farther off stays at the rim of the box, and its error is told in full.
    seen = measured[shown].reshape(-1, 3)
    seen = seen[np.isfinite(seen).all(1)]
    seen = np.clip(seen, everything.min(0) - extent, everything.max(0) + extent)
    everything = np.concatenate([everything, seen])
    low, high = everything.min(0) - 0.02 * extent, everything.max(0) + 0.02 * extent
    document = {
        "fps": fps,
        "frames": shown.tolist(),
        "low": low.tolist(),
        "high": high.tolist(),
        "markers": markers,
        "sigma": sigma,
        "fit": list(fit),
        "measured": quantise(measured[shown], low, high),
        "models": [
            {
                "label": label,
                "errors": encoded(np.linalg.norm(measured - points[:, :markers], axis=2)[shown], "<f4"),
                **modes_of(points[shown], (low, high), TOLERANCE * extent, rank),
            }
            for label, points in models.items()
        ],
    }
    if arrows is not None and force is not None:
        document |= {
            "arrows": quantise(arrows, low, high),
            "arrow_count": arrows.shape[1],
            "largest_force": float(np.linalg.norm(force[2], axis=2).max(initial=0.0)),
        }
    return document


def _rank(points: np.ndarray, models: int, budget: int) -> int:
    """Modes that the budget has room for."""
    return max(int((1.0 - MEASURED_SHARE) * budget / models / (6 * points.shape[1])), 3)


def _arrows(force: Force, frames: int, extent: float) -> np.ndarray:
    """(T, C, 2, 3) foot and tip of every arrow [m], NaN in frames without a force."""
    at, place, value = force
    longest = float(np.linalg.norm(value, axis=2).max(initial=0.0))
    scale = ARROW * extent / longest if longest > 0.0 else 0.0
    arrows = np.full((frames, place.shape[1], 2, 3), np.nan)
    known = at < frames
    arrows[at[known], :, 0] = place[known]
    arrows[at[known], :, 1] = (place + scale * value)[known]
    return arrows
