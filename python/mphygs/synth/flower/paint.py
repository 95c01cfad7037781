"""What a flower's surface looks like: colours with veins, spots and mottling, fixed to the material."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

Colour = tuple[float, float, float]


@dataclass(frozen=True)
class BladePaint:
    """Of petals and leaves. root, tip, vein: colours; veins: number of them across (or along, where they
    branch off the middle one: branched); spots: share of the surface that is covered by dots of `vein`."""

    root: Colour
    tip: Colour
    vein: Colour
    veins: float = 7.0
    branched: bool = False
    spots: float = 0.0


@dataclass(frozen=True)
class RoundPaint:
    """Of stems and receptacles. below, above: colours on either side of `border` along the part; florets:
    whether the upper one is a head of small florets."""

    below: Colour
    above: Colour
    border: float = 2.0
    florets: bool = False


@dataclass(frozen=True, eq=False)
class Mottling:
    """A random field with a few waves of every length, the same for the same seed.

    waves: (K, 3) [rad/m]; phases: (K,); weights: (K,), of squares that add up to 2.
    """

    waves: np.ndarray
    phases: np.ndarray
    weights: np.ndarray

    @classmethod
    def of(cls, generator: np.random.Generator, lengths: tuple[float, ...], each: int = 9) -> Mottling:
        """lengths: of the waves [m], `each` of every one in random directions."""
        direction = generator.standard_normal((len(lengths) * each, 3))
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        size = np.repeat(2.0 * np.pi / np.asarray(lengths), each) * generator.uniform(
            0.8, 1.25, len(direction)
        )
        weights = np.full(len(direction), np.sqrt(2.0 / len(direction)))
        return cls(direction * size[:, None], generator.uniform(0.0, 2.0 * np.pi, len(direction)), weights)

    def __call__(self, places: np.ndarray) -> np.ndarray:
        """Values (N,), of unit variance, at places (N, 3) [m]."""
        return np.sin(places @ self.waves.T + self.phases) @ self.weights


def painted(
    paint: BladePaint | RoundPaint,
    along: np.ndarray,
    across: np.ndarray,
    number: np.ndarray,
    places: np.ndarray,
    coarse: Mottling,
    fine: Mottling,
) -> np.ndarray:
    """Colours (N, 3), 0 to 1, of points of a surface; along, across, number: (N,) as on a Surface; places:
    (N, 3) at rest [m]."""
    if isinstance(paint, BladePaint):
        colour = _blade(paint, along, across, number, places, fine)
    else:
        colour = _round(paint, along, across)
    light = 1.0 + 0.10 * coarse(places) + 0.09 * fine(places)
    return np.clip(colour * light[:, None], 0.0, 1.0)


def _blade(
    paint: BladePaint,
    along: np.ndarray,
    across: np.ndarray,
    number: np.ndarray,
    places: np.ndarray,
    fine: Mottling,
) -> np.ndarray:
    colour = _mix(paint.root, paint.tip, np.clip(1.3 * along, 0.0, 1.0) ** 0.8)
    # no two blades are quite alike
    shift = 0.05 * np.sin(number[:, None] * 2.4 + np.array([0.0, 2.1, 4.2]))
    colour = colour * (1.0 + shift)
    if paint.branched:
        phase = paint.veins * (along - 0.28 * np.abs(across))
    else:
        phase = 0.5 * paint.veins * across * (1.0 + 0.25 * along)
    distance = np.abs(phase - np.round(phase))
    line = 0.75 * np.exp(-((distance / 0.13) ** 2)) * (1.0 - 0.6 * along)
    rib = np.exp(-((across / 0.07) ** 2)) * (1.0 - 0.5 * along)
    share = np.maximum(line, 0.9 * rib)
    if paint.spots > 0.0:
        dots = _step(fine(places * 0.8) - 2.0 * (0.5 - paint.spots), 0.15) * (along < 0.75) * (along > 0.1)
        share = np.maximum(share, dots)
    return colour + share[:, None] * (np.asarray(paint.vein) - colour)


def _round(paint: RoundPaint, along: np.ndarray, across: np.ndarray) -> np.ndarray:
    above = _step(along - paint.border, 0.02)
    below = np.asarray(paint.below) * (1.0 + 0.12 * np.cos(9.0 * np.pi * across))[:, None]
    upper = np.broadcast_to(np.asarray(paint.above), below.shape)
    if paint.florets:
        spiral = np.cos(np.pi * 13.0 * across + 34.0 * along) * np.cos(np.pi * 21.0 * across - 29.0 * along)
        upper = upper * (1.0 + 0.4 * spiral)[:, None]
    return below + above[:, None] * (upper - below)


def _mix(first: Colour, second: Colour, share: np.ndarray) -> np.ndarray:
    return np.asarray(first) + share[:, None] * (np.asarray(second) - np.asarray(first))


def _step(value: np.ndarray, width: float) -> np.ndarray:
    return 0.5 * (1.0 + np.tanh(value / width))
