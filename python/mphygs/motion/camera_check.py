"""Whether every camera sees the object where all of them together put it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch

from mphygs.capture.errors import fault
from mphygs.capture.views import Photograph
from mphygs.render.image_metrics import intersection_over_union
from mphygs.render.splatting import splat
from mphygs.scene.gaussians import Gaussians

# Intersection over union of the silhouette drawn and the one seen, below which it is not the same thing: an
# object that was found badly is still there for a good part.
LEAST_OVERLAP = 0.3


def check_cameras(
    gaussians: Gaussians, refined: np.ndarray, photographs: Sequence[Photograph], *, where: str
) -> dict[str, float]:
    """Camera -> intersection over union of the object's silhouette, drawn and seen.

    gaussians: at rest; refined: (K, 3) [m], where they are in the frame of the photographs; where: how
    messages name it. Raises CaptureError, with the camera's name, where one of them sees it elsewhere.
    """
    places = torch.as_tensor(refined, dtype=gaussians.positions.dtype)
    bare = replace(gaussians, positions=places, features=gaussians.features[:, :0])
    with torch.no_grad():
        overlap = {
            p.camera.name: intersection_over_union(splat(bare, p.camera).opacity.numpy(), p.mask)
            for p in photographs
        }
    off = [name for name, value in overlap.items() if value < LEAST_OVERLAP]
    if not off:
        return overlap
    worst = min(off, key=overlap.__getitem__)
    if len(off) == 1 and len(overlap) > 2:
        others = min(value for name, value in overlap.items() if name != worst)
        raise fault(
            where,
            f'camera "{worst}" shares {overlap[worst]:.0%} of its silhouette with the object that the others '
            f"put together (they {others:.0%} and more)",
            f'its pose corrected, or "{worst}" left out',
        )
    raise fault(
        where,
        f'the object is not found where the cameras see it ("{worst}" shares {overlap[worst]:.0%})',
        "the object of the rest views, cameras in one frame of reference, correspondences where it turned",
    )
