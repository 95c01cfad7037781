"""Groups of pixels that SAM or SAM2 (Kirillov et al. 2023; Ravi et al. 2024) finds, from a local folder."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import torch

from mphygs.capture.local_networks import local_network, normalised
from mphygs.capture.views import Photograph

_KINDS = {"sam": "SamModel", "sam2": "Sam2Model", "sam2_video": "Sam2Model"}
_TOGETHER = 32  # points asked about at once


@dataclass(frozen=True, eq=False)
class SamGroups:
    """Masks about a grid of points on the object.

    points: along each side of the picture; score, stability: below which a mask is dropped, its predicted
    overlap and the overlap of the mask at two thresholds; same: overlap from which two masks are one;
    least: pixels of a mask, share of the object's.
    """

    network: torch.nn.Module
    points: int = 24
    score: float = 0.86
    stability: float = 0.9
    same: float = 0.8
    least: float = 0.003
    name: str = "sam"

    @classmethod
    def of(cls, folder: Path) -> SamGroups:
        """The network in `folder`. Raises CaptureError where there is none that can be used."""
        return cls(local_network(folder, _KINDS, "a SAM or SAM2"))

    def groups_of(self, photograph: Photograph) -> list[np.ndarray]:
        """(H, W) three times: where masks overlap the smallest counts, that of middle size, the largest."""
        masks = self._masks(photograph)
        shape = photograph.mask.shape
        order = sorted(masks, key=lambda mask: int(mask.sum()))
        third = len(order) // 3
        middle = order[third : len(order) - third]
        return [_painted(each, shape) for each in (order[::-1], middle[::-1], order)]

    def _masks(self, photograph: Photograph) -> list[np.ndarray]:
        height, width = photograph.mask.shape
        side = max(height, width)
        solid = photograph.mask >= 0.5
        size = _input_size(self.network)
        # made square, so that networks that keep the picture's proportions and those that do not see the same
        square = np.zeros((side, side, 3), dtype=np.float32)
        square[:height, :width] = photograph.colour
        points = _grid(solid, self.points) * (size / side)
        if len(points) == 0:
            return []
        found: list[tuple[float, np.ndarray]] = []
        with torch.inference_mode():
            embedding = self.network.get_image_embeddings(normalised(square, size, size))
            for first in range(0, len(points), _TOGETHER):
                chunk = torch.from_numpy(points[first : first + _TOGETHER].astype(np.float32))
                answer = self.network(
                    image_embeddings=embedding,
                    input_points=chunk[None, :, None],
                    input_labels=torch.ones(1, len(chunk), 1, dtype=torch.int64),
                    multimask_output=True,
                )
                logits = answer.pred_masks[0].flatten(0, 1).float().numpy()
                scores = answer.iou_scores[0].flatten().float().numpy()
                found += self._kept(logits, scores, solid, side)
        return _distinct(found, self.same)

    def _kept(
        self, logits: np.ndarray, scores: np.ndarray, solid: np.ndarray, side: int
    ) -> list[tuple[float, np.ndarray]]:
        height, width = solid.shape
        kept = []
        for logit, score in zip(logits, scores, strict=True):
            large = cv2.resize(logit, (side, side), interpolation=cv2.INTER_LINEAR)[:height, :width]
            loose, tight = (large > -1.0).sum(), (large > 1.0).sum()
            mask = (large > 0.0) & solid
            enough = mask.sum() >= max(self.least * solid.sum(), 1)
            # what lies mostly beside the object is the background's
            own = mask.sum() >= 0.7 * max((large > 0.0).sum(), 1)
            if score >= self.score and tight >= self.stability * max(loose, 1) and enough and own:
                kept.append((float(score), mask))
        return kept


def _input_size(network: torch.nn.Module) -> int:
    size = network.config.prompt_encoder_config.image_size
    return int(size if isinstance(size, int) else size[0])


def _grid(solid: np.ndarray, count: int) -> np.ndarray:
    """Points (N, 2) [px] of a regular grid over the picture that lie on the object."""
    height, width = solid.shape
    step = max(height, width) / count
    v, u = np.meshgrid(np.arange(0.5 * step, height, step), np.arange(0.5 * step, width, step), indexing="ij")
    points = np.stack([u.ravel(), v.ravel()], axis=1)
    return points[solid[points[:, 1].astype(int), points[:, 0].astype(int)]]


def _distinct(found: list[tuple[float, np.ndarray]], same: float) -> list[np.ndarray]:
    """The masks, best first, without those that one before them nearly equals."""
    kept: list[np.ndarray] = []
    for _, mask in sorted(found, key=lambda pair: -pair[0]):
        if all((mask & other).sum() < same * (mask | other).sum() for other in kept):
            kept.append(mask)
    return kept


def _painted(masks: list[np.ndarray], shape: tuple[int, int]) -> np.ndarray:
    """Group numbers (H, W), later masks over earlier ones, -1 where there is none."""
    groups = np.full(shape, -1, dtype=np.int32)
    for mask in masks:
        groups[mask] = groups.max() + 1
    names, number = np.unique(groups, return_inverse=True)
    return (number.reshape(shape) - int((names == -1).any())).astype(np.int32)
