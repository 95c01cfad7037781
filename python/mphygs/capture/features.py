"""Feature maps: what a picture looks like at every place, as vectors, and their principal components."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import cv2
import numpy as np

from mphygs.capture.views import Photograph

Report = Callable[[float, str], None]
# Pixels of all views that the principal components are found from, and pairs that give features their scale.
_MOST_PIXELS, _PAIRS = 60_000, 40_000


class FeatureExtractor(Protocol):
    """Whatever gives a feature map of a picture.

    name: how results name it. The same picture gives the same map.
    """

    name: str

    def map_of(self, photograph: Photograph) -> np.ndarray:
        """(h, w, F) float32, at most as fine as the picture; every cell stands for an equal share of it."""
        ...


@dataclass(frozen=True)
class ColourFeatures:
    """Lightness and the two opponent colours of CIELAB over 100, of the pictures a little smoothed.

    Lightness counts `lightness` times as much as colour: shading is not material.
    """

    lightness: float = 0.4
    smoothing: float = 0.008  # standard deviation over the picture's longest side
    name: str = "colour"

    def map_of(self, photograph: Photograph) -> np.ndarray:
        """(H, W, 3), means over the object's pixels nearby alone."""
        sigma = self.smoothing * max(photograph.colour.shape[:2])
        mask = photograph.mask.astype(np.float32)
        total = cv2.GaussianBlur(photograph.colour * mask[..., None], (0, 0), sigma)
        weight = cv2.GaussianBlur(mask, (0, 0), sigma)[..., None]
        colour = np.clip(total / np.maximum(weight, 1e-3), 0.0, 1.0).astype(np.float32)
        lab = cv2.cvtColor(colour, cv2.COLOR_RGB2LAB) / np.float32(100.0)
        return lab * np.array([self.lightness, 1.0, 1.0], dtype=np.float32)


@dataclass(frozen=True, eq=False)
class JoinedFeatures:
    """The maps of several extractors side by side, each brought to one scale and weighted."""

    extractors: tuple[FeatureExtractor, ...]
    weights: tuple[float, ...]

    @property
    def name(self) -> str:
        """The names with a plus between them."""
        return "+".join(extractor.name for extractor in self.extractors)


@dataclass(frozen=True, eq=False)
class Principal:
    """Principal components. mean: (F,); axes: (F, D), columns; scale: what the projections are divided by, so
    that two random places of the object differ by a squared distance of 1 in the mean."""

    mean: np.ndarray
    axes: np.ndarray
    scale: float

    def of(self, values: np.ndarray) -> np.ndarray:
        """Values (..., F) as (..., D), float32."""
        return ((values - self.mean) @ self.axes / self.scale).astype(np.float32)


@dataclass(frozen=True, eq=False)
class Reduction:
    """How maps of one or several extractors become D channels. parts: of each its components and weight."""

    parts: tuple[tuple[Principal, float], ...]

    def map_of(self, photograph: Photograph, extractor: FeatureExtractor | JoinedFeatures) -> np.ndarray:
        """The reduced map of another picture, (h, w, D) float32. extractor: that the reduction was found for.

        Raises ValueError for an extractor of other channels.
        """
        each = extractor.extractors if isinstance(extractor, JoinedFeatures) else (extractor,)
        if len(each) != len(self.parts):
            raise ValueError(f"{extractor.name}: {len(each)} extractors; expected {len(self.parts)}")
        maps = []
        for one, (principal, weight) in zip(each, self.parts, strict=True):
            values = one.map_of(photograph)
            if values.shape[2] != len(principal.mean):
                raise ValueError(f"{one.name}: {values.shape[2]} channels; expected {len(principal.mean)}")
            maps.append(np.float32(weight) * principal.of(values))
        return _side_by_side(maps)


@dataclass(frozen=True, eq=False)
class FeatureMaps:
    """Maps of all views by one extractor after reduction. maps: a view (h, w, D) float32; name: of it."""

    name: str
    maps: tuple[np.ndarray, ...]
    reduction: Reduction


def principal_components(samples: np.ndarray, count: int, *, seed: int = 0) -> Principal:
    """The `count` directions (fewer where there are fewer) in which samples (N, F) vary most.

    Raises ValueError for no samples and for numbers that are not finite.
    """
    samples = np.asarray(samples, dtype=np.float64)
    if samples.ndim != 2 or len(samples) < 2 or count < 1:
        raise ValueError(
            f"samples: have shape {samples.shape}, {count} wanted; expected (N, F), N at least 2"
        )
    if not np.isfinite(samples).all():
        raise ValueError("samples: hold values that are not finite; expected numbers")
    mean = samples.mean(axis=0)
    centred = samples - mean
    values, vectors = np.linalg.eigh(centred.T @ centred / len(samples))
    axes = vectors[:, ::-1][:, : min(count, samples.shape[1])]
    # the sign of an eigenvector is arbitrary: its largest entry is made positive
    axes = axes * np.sign(axes[np.abs(axes).argmax(axis=0), np.arange(axes.shape[1])])
    draw = np.random.default_rng(seed)
    first, second = draw.integers(len(samples), size=(2, _PAIRS))
    projected = centred @ axes
    square = float(((projected[first] - projected[second]) ** 2).sum(axis=1).mean())
    return Principal(mean, axes, float(np.sqrt(square)) if square > 0 else 1.0)


def map_weight(photograph: Photograph, shape: tuple[int, int]) -> np.ndarray:
    """How much of each cell of a map (h, w) the object fills, (h, w), 0 to 1."""
    return cv2.resize(photograph.mask.astype(np.float32), (shape[1], shape[0]), interpolation=cv2.INTER_AREA)


def feature_maps(
    photographs: Sequence[Photograph],
    extractor: FeatureExtractor | JoinedFeatures,
    *,
    components: int,
    seed: int = 0,
    report: Report | None = None,
) -> FeatureMaps:
    """The maps of all pictures, reduced to `components` channels by what varies on the object in all of them.

    Joined extractors are reduced each for itself, `components` shared out, and scaled by their weights.
    report: called with the share that is done and what comes now.
    """
    if not isinstance(extractor, JoinedFeatures):
        values, principal = _reduced(photographs, extractor, components, seed, report)
        return FeatureMaps(extractor.name, values, Reduction(((principal, 1.0),)))
    count = len(extractor.extractors)
    blocks, parts = [], []
    for number, (each, weight) in enumerate(zip(extractor.extractors, extractor.weights, strict=True)):
        part = None if report is None else _within(report, number / count, 1 / count)
        share = max(components // count, 1)
        found, principal = _reduced(photographs, each, share, seed, part)
        blocks.append([np.float32(weight) * values for values in found])
        parts.append((principal, weight))
    joined = tuple(_side_by_side(views) for views in zip(*blocks, strict=True))
    return FeatureMaps(extractor.name, joined, Reduction(tuple(parts)))


def _side_by_side(maps: Sequence[np.ndarray]) -> np.ndarray:
    """Maps of one picture as one, at the resolution of the coarsest."""
    height, width = (min(values.shape[axis] for values in maps) for axis in (0, 1))
    return np.concatenate([_brought_to(values, height, width) for values in maps], axis=2)


def _reduced(
    photographs: Sequence[Photograph],
    extractor: FeatureExtractor,
    components: int,
    seed: int,
    report: Report | None,
) -> tuple[tuple[np.ndarray, ...], Principal]:
    maps, samples = [], []
    draw = np.random.default_rng(seed)
    for number, photograph in enumerate(photographs):
        if report is not None:
            report(number / len(photographs), f"{extractor.name} features of {photograph.camera.name}")
        values = extractor.map_of(photograph)
        own = values[map_weight(photograph, values.shape[:2]) >= 0.9]
        kept = min(len(own), _MOST_PIXELS // len(photographs))
        samples.append(own[draw.permutation(len(own))[:kept]])
        maps.append(values)
    principal = principal_components(np.concatenate(samples), components, seed=seed)
    return tuple(principal.of(values) for values in maps), principal


def _within(report: Report, start: float, share: float) -> Report:
    return lambda done, text: report(start + share * done, text)


def _brought_to(values: np.ndarray, height: int, width: int) -> np.ndarray:
    """A map (h, w, D) at a resolution that is at most as fine, by means."""
    if values.shape[:2] == (height, width):
        return values
    resized = cv2.resize(values, (width, height), interpolation=cv2.INTER_AREA)
    return resized.reshape(height, width, values.shape[2])
