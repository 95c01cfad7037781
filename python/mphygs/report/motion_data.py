"""Motions packed for the viewer: positions as 16-bit numbers in a box, in base64."""

from __future__ import annotations

import base64

import numpy as np

# Frames that a page carries of one sequence; longer ones are thinned out.
LARGEST_FRAME_COUNT = 160
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
) -> dict[str, object]:
    """One sequence for the viewer.

    measured, predicted: (T, M, 3) [m]; surface: (T, S, 3) [m], predicted; surface_part: (S,) index; normals:
    (S, 3) at rest; fit: frames fitted. Raises ValueError where the shapes do not belong together.
    """
    if measured.shape != predicted.shape or len(surface) != len(predicted):
        raise ValueError(
            f"motion: measured {measured.shape}, predicted {predicted.shape}, surface {surface.shape}"
        )
    stride = max(1, -(-len(predicted) // LARGEST_FRAME_COUNT))
    shown = np.arange(0, len(predicted), stride)
    everything = np.concatenate([predicted[shown], surface[shown]], axis=1).reshape(-1, 3)
    margin = 0.02 * np.ptp(everything, axis=0).max()
    low, high = everything.min(0) - margin, everything.max(0) + margin
    # A measurement that is far off stays at the rim of the box.
    return {
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
