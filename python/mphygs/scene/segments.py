"""Segments of an object: places that look alike, were grouped together in pictures, and are equally thick."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree
from sklearn.cluster import HDBSCAN

_NEIGHBOURS = 20  # that a label is smoothed over
_NEAREST = 10  # labelled places that a place without a label asks
_NONE = 1e-150  # below any distance or variance: what would be divided by nothing


@dataclass(frozen=True, eq=False)
class FeatureBlock:
    """Features that places are grouped by. values: (N, F), their scale is taken out; weight: beside others;
    tells: whether they also say that two segments are of one kind."""

    values: np.ndarray
    weight: float
    tells: bool = True


@dataclass(frozen=True)
class SegmentSettings:
    """How places are grouped.

    samples: places that are clustered, the others follow them; dimensions: kept by the principal components;
    least_cluster: of a cluster, share of the samples; core: neighbours that make a place dense; place: weight
    of the position beside features of weight 1; rounds: of smoothing; alike: distance of two segments' means
    below which they are one, over the largest at which the features of both still make one mode; 0 for
    never; least_segment: of a segment, share of all places; most: segments.
    """

    samples: int = 6000
    dimensions: int = 12
    least_cluster: float = 0.012
    core: int = 8
    place: float = 0.6
    rounds: int = 4
    alike: float = 1.0
    least_segment: float = 0.01
    most: int = 25
    seed: int = 0

    def __post_init__(self) -> None:
        if self.samples < 50 or self.dimensions < 1 or self.most < 1 or not 0 < self.least_cluster < 0.5:
            raise ValueError(f"{self}: expected samples >= 50, dimensions and most >= 1, shares below 1/2")


def find_segments(
    positions: np.ndarray,
    blocks: Sequence[FeatureBlock],
    settings: SegmentSettings | None = None,
) -> np.ndarray:
    """Labels (N,) int32 of places (N, 3) [m], 0 for the largest segment.

    Features are averaged over the nearest places, joined with the position, reduced, and clustered finely by
    HDBSCAN (Campello et al. 2013, leaves); places that belong to no cluster take the label of most of the
    nearest that do. Of these pieces those whose features make one mode together become one segment, wherever
    they are: the petals of a ring, whose places differ as much within a petal as between two. Small segments
    are joined with the neighbour that they are most like. Raises ValueError for fewer
    than 50 places.
    """
    settings = SegmentSettings() if settings is None else settings
    if len(positions) < 50:
        raise ValueError(f"{len(positions)} places; expected at least 50 to find segments in")
    near = cKDTree(positions).query(positions, k=_NEIGHBOURS)[1]
    used = [block for block in blocks if block.values.shape[1] and block.weight > 0]
    if not any(block.tells for block in used):
        raise ValueError("blocks: none tells segments apart; expected features of a weight above zero")
    scaled = [block.weight * _scaled(_averaged(block.values, near)) for block in used]
    kind = _scaled(np.concatenate([s for s, b in zip(scaled, used, strict=True) if b.tells], axis=1))
    features = np.concatenate([*scaled, settings.place * _scaled(positions)], axis=1)
    reduced = _reduced(features, settings.dimensions)
    draw = np.random.default_rng(settings.seed)
    chosen = np.sort(draw.permutation(len(positions))[: settings.samples])
    cluster = (
        HDBSCAN(
            min_cluster_size=max(int(settings.least_cluster * len(chosen)), 5),
            min_samples=settings.core,
            cluster_selection_method="leaf",
            copy=True,
        )
        .fit(reduced[chosen])
        .labels_
    )
    if (cluster < 0).all():
        cluster = np.zeros_like(cluster)
    label = _followed(reduced, chosen, cluster)
    label = _smoothed(label, near, settings.rounds)
    label = _alike(label, kind, settings.alike)
    label = _joined(label, kind, near, settings)
    return _by_size(label)


def _averaged(values: np.ndarray, near: np.ndarray) -> np.ndarray:
    return np.asarray(values, dtype=np.float64)[near].mean(axis=1)


def _scaled(values: np.ndarray) -> np.ndarray:
    """Values (N, F) whose squared distances are 1 in the mean, about zero."""
    centred = np.asarray(values, dtype=np.float64) - values.mean(axis=0)
    spread = np.sqrt(2.0 * (centred**2).sum(axis=1).mean())
    return centred / spread if spread > 0 else centred


def _reduced(features: np.ndarray, dimensions: int) -> np.ndarray:
    centred = features - features.mean(axis=0)
    axes = np.linalg.eigh(centred.T @ centred)[1][:, ::-1]
    return centred @ axes[:, :dimensions]


def _followed(features: np.ndarray, chosen: np.ndarray, cluster: np.ndarray) -> np.ndarray:
    """Every place's label: that of most of the nearest samples of a cluster."""
    known = cluster >= 0
    count = int(cluster.max()) + 1
    tree = cKDTree(features[chosen[known]])
    nearest = tree.query(features, k=min(_NEAREST, int(known.sum())))[1].reshape(len(features), -1)
    return _majority(cluster[known][nearest], count)


def _majority(labels: np.ndarray, count: int) -> np.ndarray:
    """The label (N,) that is most frequent in each row of labels (N, M), the smallest of several."""
    rows = np.repeat(np.arange(len(labels)), labels.shape[1])
    flat = np.bincount(rows * count + labels.ravel(), minlength=len(labels) * count)
    return flat.reshape(len(labels), count).argmax(axis=1)


def _smoothed(label: np.ndarray, near: np.ndarray, rounds: int) -> np.ndarray:
    count = int(label.max()) + 1
    for _ in range(rounds):
        label = _majority(label[near], count)
    return label


def _alike(label: np.ndarray, features: np.ndarray, reach: float) -> np.ndarray:
    """Labels with segments joined, first those that are nearest for what one mode spans, until no two are
    nearer than `reach` of it."""
    names, label = np.unique(label, return_inverse=True)
    size = np.bincount(label).astype(np.float64)
    mean = np.stack([features[label == k].mean(axis=0) for k in range(len(names))])
    spread = np.stack([np.cov(features[label == k].T, bias=True) for k in range(len(names))])
    spread = spread.reshape(len(names), features.shape[1], features.shape[1])
    left = list(range(len(names)))
    while len(left) > 1:
        apart = _distance_over_one_mode(mean[left], spread[left])
        first, second = (left[k] for k in np.unravel_index(int(apart.argmin()), apart.shape))
        if apart.min() >= reach:
            break
        share, away = size[second] / (size[first] + size[second]), mean[second] - mean[first]
        spread[first] += share * (spread[second] - spread[first])
        spread[first] += share * (1.0 - share) * np.outer(away, away)
        mean[first] += share * away
        size[first] += size[second]
        label[label == second] = first
        left.remove(second)
    return label


def _distance_over_one_mode(mean: np.ndarray, spread: np.ndarray) -> np.ndarray:
    """Distances (K, K) of means (K, F) over the largest at which normal distributions of the spreads that
    covariances (K, F, F) have along the line between them make one mode, whatever their shares; inf on the
    diagonal."""
    away = mean[:, None] - mean
    distance = np.linalg.norm(away, axis=2)
    line = away / np.maximum(distance, _NONE)[..., None]
    along = np.maximum(np.einsum("ijf,ifg,ijg->ij", line, spread, line), 0.0)
    found = distance / np.maximum(_span_of_one_mode(along, along.T), _NONE)
    np.fill_diagonal(found, np.inf)
    return found


def _span_of_one_mode(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Distance of the means of two normal distributions of these variances up to which their mixture has one
    mode, whatever their shares: two standard deviations of equal ones (Schilling and others 2002, "Is human
    height bimodal?")."""
    wide = np.maximum(first, second)
    r = np.minimum(first, second) / np.maximum(wide, _NONE)
    root, rest = 2.0 * (1.0 - r + r**2) ** 1.5, (1.0 + r) * (2.0 - r) * (1.0 - 2.0 * r)
    # Both sides are root - rest; the left one keeps its digits for small r, where the right one has none.
    square = np.where(r < 0.5, 27.0 * (r * (1.0 - r)) ** 2 / np.maximum(root + rest, 1.0), root - rest)
    return np.sqrt(square * wide / np.maximum(r, _NONE))


def _joined(
    label: np.ndarray, features: np.ndarray, near: np.ndarray, settings: SegmentSettings
) -> np.ndarray:
    """Labels with segments joined, smallest first, until none is too small and there are not too many.

    A segment goes to the one that it shares most border with for how unlike the two are.
    """
    label = label.copy()
    while True:
        names, size = np.unique(label, return_counts=True)
        smallest = int(size.argmin())
        enough = size[smallest] >= settings.least_segment * len(label)
        if len(names) == 1 or (enough and len(names) <= settings.most):
            return label
        own = label == names[smallest]
        touching = label[near[own]].ravel()
        border = np.array([(touching == name).sum() for name in names], dtype=np.float64)
        centre = np.array([features[label == name].mean(axis=0) for name in names])
        away = ((centre - centre[smallest]) ** 2).sum(axis=1)
        liking = np.where(names == names[smallest], -1.0, (border + 1e-3) / (away + 1e-6))
        label[own] = names[int(liking.argmax())]


def _by_size(label: np.ndarray) -> np.ndarray:
    names, inverse, size = np.unique(label, return_inverse=True, return_counts=True)
    rank = np.empty(len(names), dtype=np.int32)
    rank[np.argsort(-size, kind="stable")] = np.arange(len(names))
    return rank[inverse]
