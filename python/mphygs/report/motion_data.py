"""Motions packed for the viewer: positions as 16-bit numbers in a box, in base64."""

from __future__ import annotations

import base64

import numpy as np

# Frames that a page carries of one sequence; longer ones are thinned out.
LARGEST_FRAME_COUNT = 160
# Of the longest arrow, beside the extent of the motion.
ARROW = 0.15
# The 16-bit number of a value that was not measured, and the largest that is one.
MISSING, LARGEST = -32768, 32767


def quantise(values: np.ndarray, low: np.ndarray, high: np.ndarray) -> str:
    """Positions (..., 3) [m] in the box low to high as little-endian int16 in base64; NaN is MISSING."""
    span = np.where(high > low, high - low, 1.0)
    scaled = np.rint((values - low) / span * 2.0 * LARGEST - LARGEST)
    whole = np.where(np.isfinite(scaled), np.clip(scaled, -LARGEST, LARGEST), MISSING)
    return base64.b64encode(whole.astype("<i2").tobytes()).decode("ascii")


def restore(text: str, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Positions (N, 3) [m] of what `quantise` made; NaN where missing."""
    whole = np.frombuffer(base64.b64decode(text), "<i2").astype(float).reshape(-1, 3)
    span = np.where(high > low, high - low, 1.0)
    return np.where(whole == MISSING, np.nan, (whole + LARGEST) / (2.0 * LARGEST) * span + low)


def motion_document(
    *,
    fps: float,
    measured: np.ndarray,
    predicted: np.ndarray,
    surface: np.ndarray,
    surface_part: np.ndarray,
    normals: np.ndarray,
    fit: tuple[int, int],
    force: tuple[np.ndarray, np.ndarray, np.ndarray] | None = None,
) -> dict[str, object]:
    """One sequence for the viewer.

    measured, predicted: (T, M, 3) [m]; surface: (T, S, 3) [m], predicted; surface_part: (S,) index; normals:
    (S, 3) at rest; fit: frames fitted; force: frames (K,), places (K, C, 3) [m] and missing force (K, C, 3)
    [N/kg] there. Raises ValueError where the shapes do not belong together.
    """
    if measured.shape != predicted.shape or len(surface) != len(predicted):
        raise ValueError(
            f"motion: measured {measured.shape}, predicted {predicted.shape}, surface {surface.shape}"
        )
    stride = max(1, -(-len(predicted) // LARGEST_FRAME_COUNT))
    shown = np.arange(0, len(predicted), stride)
    everything = np.concatenate([predicted[shown], surface[shown]], axis=1).reshape(-1, 3)
    arrows = None
    if force is not None:
        arrows = _arrows(force, len(predicted), float(np.ptp(everything, axis=0).max()))[shown]
        everything = np.concatenate([everything, arrows.reshape(-1, 3)])
        everything = everything[np.isfinite(everything).all(1)]
    margin = 0.02 * np.ptp(everything, axis=0).max()
    low, high = everything.min(0) - margin, everything.max(0) + margin
    # A measurement that is far off stays at the rim of the box.
    document = {
        "fps": fps,
        "frames": shown.tolist(),
        "low": low.tolist(),
        "high": high.tolist(),
        "markers": measured.shape[1],
        "points": surface.shape[1],
        "measured": quantise(measured[shown], low, high),
        "predicted": quantise(predicted[shown], low, high),
        "surface": quantise(surface[shown], low, high),
        "part": surface_part.tolist(),
        "normals": np.round(normals, 3).tolist(),
        "fit": list(fit),
    }
    if arrows is not None and force is not None:
        largest = float(np.linalg.norm(force[2], axis=2).max(initial=0.0))
        document |= {
            "arrows": quantise(arrows, low, high),
            "arrow_count": arrows.shape[1],
            "largest_force": largest,
        }
    return document


def _arrows(
    force: tuple[np.ndarray, np.ndarray, np.ndarray], frames: int, extent: float
) -> np.ndarray:
    """(T, C, 2, 3) foot and tip of every arrow [m], NaN in frames without a force."""
    at, place, value = force
    longest = float(np.linalg.norm(value, axis=2).max(initial=0.0))
    scale = ARROW * extent / longest if longest > 0.0 else 0.0
    arrows = np.full((frames, place.shape[1], 2, 3), np.nan)
    known = at < frames
    arrows[at[known], :, 0] = place[known]
    arrows[at[known], :, 1] = (place + scale * value)[known]
    return arrows
