"""Markers inside an object and on its surface, and what noise and loss do to their tracks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mphygs.capture.meshes import Part
from mphygs.scene.particles import inside
from mphygs.synth.rod_net import Line

NOISES = ("white", "correlated", "jitter", "rounded", "heavy", "growing")
# Degrees of freedom of Student's t where tails are heavy; sigma of the last frame over that of the first
# where noise grows.
HEAVY, GROWTH = 4, 4.0
# Of a cable's width, how far a cross on it reaches to every side.
ARM = 1.5


@dataclass(frozen=True)
class Noise:
    """Noise of one coordinate of one marker.

    kind: white; correlated: a share of the variance follows an AR(1) in time; jitter: a share is common to
    all markers of a frame; rounded: a share is that of values rounded to a grid; heavy: white, of Student's t
    of few degrees of freedom; growing: white, growing with the frames. sigma: [m], of all together, root mean
    square over the frames; share: of the variance; correlation: from frame to frame; dropout: share of the
    values that are missing.
    """

    kind: str = "white"
    sigma: float = 2e-4
    share: float = 0.5
    correlation: float = 0.9
    dropout: float = 0.02

    def __post_init__(self) -> None:
        if self.kind not in NOISES:
            raise ValueError(f"noise '{self.kind}': expected one of {', '.join(NOISES)}")
        if not self.sigma > 0.0:
            raise ValueError(f"noise sigma {self.sigma} m: expected above 0")
        for name, value in (
            ("share", self.share),
            ("correlation", self.correlation),
            ("dropout", self.dropout),
        ):
            if not 0.0 <= value < 1.0:
                raise ValueError(f"noise {name} {value}: expected at least 0 and below 1")


def place_markers(parts: Sequence[Part], count: int, generator: np.random.Generator) -> np.ndarray:
    """(count, 3) marker places [m], half inside and half on the surface, spread by volume and by area.

    Every part gets at least two of each kind. Raises ValueError when `count` does not allow that.
    """
    if count < 4 * len(parts):
        raise ValueError(f"{count} markers on {len(parts)} parts: expected at least {4 * len(parts)}")
    half = count // 2
    volumes = np.array([part.volume for part in parts])
    areas = np.array([_triangles(part)[1].sum() for part in parts])
    places = []
    for part, within, on in zip(parts, _shares(volumes, half), _shares(areas, count - half), strict=True):
        places += [_within(part, within, generator), _on_surface(part, on, generator)]
    return np.concatenate(places)


def place_crosses(lines: Sequence[Line], boxes: np.ndarray, count: int) -> np.ndarray:
    """(count, 3) marker places [m]: crosses of four, evenly along lines outside the boxes (H, 2, 3) [m].

    Their arms stand square to the line, ARM times as long as the rod is wide: such tell how it is twisted.
    Raises ValueError when `count` is no multiple of four or too few for every line to have two crosses.
    """
    free = []
    for line in lines:
        inside = np.any(
            [((line.place >= low - 1e-9) & (line.place <= high + 1e-9)).all(axis=1) for low, high in boxes],
            axis=0,
        )
        # What is held lies at the ends: the edge of the hold stays.
        free.append(line.place[max(np.flatnonzero(~inside)[0] - 1, 0) : np.flatnonzero(~inside)[-1] + 2])
    length = np.array([np.linalg.norm(np.diff(place, axis=0), axis=1).sum() for place in free])
    if count % 4 or count < 8 * len(lines):
        raise ValueError(
            f"{count} markers on {len(lines)} cables: expected a multiple of 4, at least {8 * len(lines)}"
        )
    places = []
    for line, place, crosses in zip(lines, free, _shares(length, count // 4), strict=True):
        arc = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(place, axis=0), axis=1))]
        station = arc[-1] * (np.arange(crosses) + 0.5) / crosses
        middle = np.stack([np.interp(station, arc, place[:, c]) for c in range(3)], axis=1)
        tangent = np.stack([np.interp(station, arc, t) for t in np.gradient(place, arc, axis=0).T], axis=1)
        first = np.cross(tangent, np.eye(3)[np.abs(tangent[0]).argmin()])
        second = np.cross(tangent, first)
        reach = 2.0 * ARM * np.sqrt(line.section.area / np.pi)
        arms = [d / np.linalg.norm(d, axis=1, keepdims=True) for d in (first, second, -first, -second)]
        places.append((middle[:, None] + reach * np.stack(arms, axis=1)).reshape(-1, 3))
    return np.concatenate(places)


def _shares(weights: np.ndarray, count: int) -> np.ndarray:
    """Whole numbers of at least two that add up to `count`, in proportion to weights."""
    numbers = np.maximum(np.floor(weights / weights.sum() * count).astype(int), 2)
    while numbers.sum() != count:
        gap = weights / weights.sum() * count - numbers
        if numbers.sum() < count:
            numbers[gap.argmax()] += 1
        else:
            numbers[np.where(numbers > 2, gap, np.inf).argmin()] -= 1
    return numbers


def _within(part: Part, count: int, generator: np.random.Generator) -> np.ndarray:
    low, high = part.bounds
    found = np.zeros((0, 3))
    while len(found) < count:
        points = generator.uniform(low, high, (4 * count, 3))
        found = np.concatenate([found, points[inside(part, points)]])
    return found[:count]


def _triangles(part: Part) -> tuple[np.ndarray, np.ndarray]:
    """Corners (F, 3, 3) [m] and areas (F,) [m^2]."""
    corners = part.vertices[part.faces]
    return corners, 0.5 * np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )


def _on_surface(part: Part, count: int, generator: np.random.Generator) -> np.ndarray:
    corners, area = _triangles(part)
    chosen = corners[generator.choice(len(area), count, p=area / area.sum())]
    weights = generator.dirichlet(np.ones(3), count)
    return np.einsum("mk,mkc->mc", weights, chosen)


def measure(position: np.ndarray, noise: Noise, generator: np.random.Generator) -> np.ndarray:
    """Tracks (T, M, 3) [m] with noise on every coordinate, NaN where a marker was not seen."""
    measured = position + noise.sigma * _unit(position.shape, noise, generator)
    if noise.kind == "rounded":
        step = noise.sigma * np.sqrt(12.0 * noise.share)
        measured = step * np.round(measured / step) if step else measured
    measured[generator.random(position.shape[:2]) < noise.dropout] = np.nan
    return measured


def _unit(shape: tuple[int, ...], noise: Noise, generator: np.random.Generator) -> np.ndarray:
    """(T, M, 3) noise of unit variance; where values are rounded besides, without the share of that."""
    if noise.kind == "heavy":
        return generator.standard_t(HEAVY, shape) * np.sqrt(1.0 - 2.0 / HEAVY)
    white = generator.standard_normal(shape)
    match noise.kind:
        case "white":
            return white
        case "growing":
            course = np.linspace(1.0, GROWTH, len(white))[:, None, None]
            return white * course / np.sqrt(np.mean(course**2))
        case "rounded":
            return np.sqrt(1.0 - noise.share) * white
        case "correlated":
            part = np.empty(shape)
            innovation = generator.standard_normal(shape)
            part[0] = innovation[0]
            for k in range(1, len(part)):
                part[k] = (
                    noise.correlation * part[k - 1] + np.sqrt(1.0 - noise.correlation**2) * innovation[k]
                )
        case _:
            part = generator.standard_normal((len(white), 1, 3))
    return np.sqrt(1.0 - noise.share) * white + np.sqrt(noise.share) * part
