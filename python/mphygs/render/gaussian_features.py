"""Appearance and affinity of Gaussians from the pictures they were made from."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import cv2
from scipy import sparse
from scipy.spatial import cKDTree

from mphygs.capture.features import (
    FeatureExtractor,
    FeatureMaps,
    JoinedFeatures,
    feature_maps,
    map_weight,
)
from mphygs.capture.mask_groups import MaskGrouper
from mphygs.capture.views import Photograph
from mphygs.render.lifting import lifted_features, seen_in_groups, seen_map
from mphygs.scene.affinity import affinity_features, neighbour_groups
from mphygs.scene.gaussians import Gaussians
from mphygs.scene.object_files import GaussianFeatures

Report = Callable[[float, str], None]
COMPONENTS, AFFINITIES = 16, 12
_FINEST = 128  # cells along a side of a map that is lifted
_BONDED = 8  # nearest Gaussians that count as a group
_SHARES = (0.35, 0.65, 0.8)  # of the work that is done after maps, lifting, groups


def gaussian_features(
    gaussians: Gaussians,
    photographs: Sequence[Photograph],
    extractor: FeatureExtractor | JoinedFeatures,
    grouper: MaskGrouper,
    *,
    made_by: str = "",
    seed: int = 0,
    report: Report | None = None,
) -> GaussianFeatures:
    """Features of every Gaussian: zD explains the extractor's maps, zA keeps the grouper's groups together.

    made_by: what names the extractor to `mphygs.capture.extractors.extractor_of`; report: called with the
    share that is done and what comes now.
    """
    tell = report if report is not None else _silent
    maps = feature_maps(
        photographs, extractor, components=COMPONENTS, seed=seed, report=_between(tell, 0.0, _SHARES[0])
    )
    seen = []
    for photograph, values in zip(photographs, _coarsened(maps).maps, strict=True):
        weight = map_weight(photograph, values.shape[:2])
        # a cell at the edge shows something else as well
        seen.append(seen_map(photograph.camera, values, weight**2))
    appearance = lifted_features(gaussians, seen, report=_between(tell, _SHARES[0], _SHARES[1])).numpy()
    groups = []
    for number, photograph in enumerate(photographs):
        span = (_SHARES[1], 1.0)
        tell(
            span[0] + (span[1] - span[0]) * number / len(photographs),
            f"{grouper.name} in {photograph.camera.name}",
        )
        for each in grouper.groups_of(photograph):
            groups.append(seen_in_groups(gaussians, photograph.camera, each))
    if not any(each.shape[1] for each in groups):
        raise ValueError(f"{grouper.name}: found no groups in any picture; expected some on the object")
    places = gaussians.positions.detach().numpy()
    near = cKDTree(places).query(places, k=min(_BONDED, len(places)))[1]
    affinity = affinity_features(sparse.hstack(groups), neighbour_groups(near), count=AFFINITIES)
    source = f"{extractor.name}, {grouper.name}"
    return GaussianFeatures(appearance, affinity, source, made_by=made_by, reduction=maps.reduction)


def _silent(share: float, text: str) -> None:
    """Nobody asked."""


def _between(report: Report, start: float, end: float) -> Report:
    return lambda share, text: report(start + (end - start) * share, text)


def _coarsened(maps: FeatureMaps) -> FeatureMaps:
    """Maps of at most so many cells along a side: features vary less than colour."""
    found = []
    for values in maps.maps:
        factor = min(_FINEST / max(values.shape[:2]), 1.0)
        height, width = (max(round(factor * side), 1) for side in values.shape[:2])
        small = cv2.resize(values, (width, height), interpolation=cv2.INTER_AREA)
        found.append(small.reshape(height, width, values.shape[2]))
    return replace(maps, maps=tuple(found))
