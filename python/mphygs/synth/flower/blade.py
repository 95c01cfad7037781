"""Blades: petals and leaves that grow out of a patch of quadrilaterals of another surface."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import PchipInterpolator

from mphygs.synth.flower.textured_surface import Surface, quads


@dataclass(frozen=True)
class Outline:
    """The shape of a blade, in its own plane and out of it.

    length, half_width, thickness: [m]; widths: share of half_width at equal steps from root to tip; rise:
    angles above the horizontal at equal steps from root to tip [degree]; cup: how far the edges bend up
    [m]; rounding: share of the length by which the edges end before the middle, below 0 for a
    blade whose middle is short; ruffle: height of waves along the edges [m]; waves: their number;
    twist: of the tip about the middle line [degree]; rows: steps from root to tip.
    """

    length: float
    half_width: float
    widths: tuple[float, ...]
    rise: tuple[float, ...]
    thickness: float = 0.0018
    cup: float = 0.0
    rounding: float = 0.2
    ruffle: float = 0.0
    waves: float = 3.0
    twist: float = 0.0
    rows: int = 10

    def varied(self, generator: np.random.Generator, amount: float) -> Outline:
        """One of many that grew alike: lengths and widths vary by `amount`, angles by 20 degrees times it."""
        size, width, angle, turn = generator.standard_normal(4)
        return replace(
            self,
            length=self.length * (1.0 + amount * float(np.tanh(size))),
            half_width=self.half_width * (1.0 + 0.5 * amount * float(np.tanh(width))),
            rise=tuple(a + 20.0 * amount * float(np.tanh(angle)) for a in self.rise),
            twist=self.twist + 20.0 * amount * float(np.tanh(turn)),
        )


@dataclass(frozen=True, eq=False)
class Root:
    """Where a blade grows. lower, upper: (W + 1, 3) the two rows of a patch, from right to left seen from
    outside [m]; out, side, up: (3,) unit vectors; centre: (3,) on the axis that it grows around [m]; wedge:
    half the angle about `up` that it may fill [rad], None for no bound; gap: between neighbours [m]."""

    lower: np.ndarray
    upper: np.ndarray
    out: np.ndarray
    side: np.ndarray
    up: np.ndarray
    centre: np.ndarray
    wedge: float | None = None
    gap: float = 0.0012


def blade(root: Root, outline: Outline, number: int) -> Surface:
    """A closed blade whose root is exactly the patch it grows from, with the patch's own triangles."""
    columns, rows = len(root.lower) - 1, outline.rows
    across = np.linspace(-1.0, 1.0, columns + 1)
    share = np.linspace(0.0, 1.0, rows + 1)
    upper, lower = _sheets(root, outline, share, across)
    side = columns + 1
    vertices = np.concatenate([upper.reshape(-1, 3), lower.reshape(-1, 3)])
    top = np.arange((rows + 1) * side).reshape(rows + 1, side)
    low = top + top.size
    faces = [
        quads(*(c.ravel() for c in (top[:-1, :-1], top[1:, :-1], top[1:, 1:], top[:-1, 1:]))),
        quads(*(c.ravel() for c in (low[:-1, :-1], low[:-1, 1:], low[1:, 1:], low[1:, :-1]))),
        quads(top[:-1, 0], low[:-1, 0], low[1:, 0], top[1:, 0]),
        quads(top[:-1, -1], top[1:, -1], low[1:, -1], low[:-1, -1]),
        quads(top[-1, :-1], low[-1, :-1], low[-1, 1:], top[-1, 1:]),
        # The root: the patch's triangles, which are cut from lower to upper, seen from behind.
        quads(low[0, :-1], low[0, 1:], top[0, 1:], top[0, :-1])[:, ::-1],
    ]
    along = np.repeat(share, side)
    return Surface(
        vertices,
        np.concatenate(faces),
        np.tile(along, 2),
        np.tile(np.tile(across, rows + 1), 2),
        np.full(len(vertices), float(number)),
    )


def _sheets(
    root: Root, outline: Outline, share: np.ndarray, across: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Upper and lower vertices (rows + 1, W + 1, 3) [m]."""
    s, a = share[:, None], across[None]
    # Rounded tips: the rows bend back towards the edges, more so towards the tip. All that shapes the blade
    # is of the place along it, not of the row, so that it never folds over.
    place = s * (1.0 - outline.rounding * s * a**2) / (1.0 + max(0.0, -outline.rounding))
    fine = np.linspace(0.0, 1.0, 201)
    angle = np.radians(_course(outline.rise)(fine))
    step = outline.length * 0.5 * (fine[1] - fine[0])
    far, high = (
        np.concatenate([[0.0], np.cumsum(step * (c[1:] + c[:-1]))]) for c in (np.cos(angle), np.sin(angle))
    )
    out, up = np.interp(place, fine, far), np.interp(place, fine, high)
    theta = np.interp(place, fine, angle)
    half = outline.half_width * np.maximum(_course(outline.widths)(place), 0.02)
    bend = outline.cup * _smooth(place / 0.5) * a**2
    wave = np.sin(2.0 * np.pi * outline.waves * (place + 0.13 * np.sign(a)))
    bend = bend + outline.ruffle * _smooth(place / 0.6) * a**2 * wave
    bend = bend + half * a * np.tan(np.radians(outline.twist)) * _smooth(place)
    thick = 0.5 * outline.thickness * (1.0 - 0.35 * place - 0.2 * a**2)
    middle = 0.5 * (root.lower + root.upper)
    start = middle.mean(axis=0) - root.centre
    blend = _smooth(s / 0.22)[..., None]
    sheets = []
    for offset, patch in ((bend + thick, root.upper), (bend - thick, root.lower)):
        radial = start @ root.out + out - np.sin(theta) * offset
        level = start @ root.up + up + np.cos(theta) * offset
        beside = half * a
        if root.wedge is not None:
            room = np.maximum(np.tan(root.wedge) * radial - 0.5 * root.gap, 2e-4)
            beside = np.clip(beside, -room * np.abs(a), room * np.abs(a))
        own = (
            root.centre
            + radial[..., None] * root.out
            + beside[..., None] * root.side
            + level[..., None] * root.up
        )
        grown = patch[None] + (outline.length * place * np.cos(angle[0]))[..., None] * root.out
        grown = grown + (outline.length * place * np.sin(angle[0]))[..., None] * root.up
        sheets.append((1.0 - blend) * grown + blend * own)
    sheets[0][0], sheets[1][0] = root.upper, root.lower
    return sheets[0], sheets[1]


def _course(values: tuple[float, ...]) -> PchipInterpolator:
    return PchipInterpolator(np.linspace(0.0, 1.0, len(values)), values)


def _smooth(share: np.ndarray) -> np.ndarray:
    x = np.clip(share, 0.0, 1.0)
    return x * x * (3.0 - 2.0 * x)
