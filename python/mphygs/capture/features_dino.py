"""DINOv2's and DINOv3's patch features (Oquab et al. 2024; Simeoni et al. 2025) from a local folder."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from mphygs.capture.local_networks import local_network, normalised
from mphygs.capture.views import Photograph

_KINDS = {
    "dinov2": "Dinov2Model",
    "dinov2_with_registers": "Dinov2WithRegistersModel",
    "dinov3_vit": "DINOv3ViTModel",
}
_PATCHES = 40  # along a picture's longest side


@dataclass(frozen=True, eq=False)
class DinoFeatures:
    """The last layer's patch tokens, of unit length."""

    network: torch.nn.Module
    patches: int = _PATCHES
    name: str = "dino"

    @classmethod
    def of(cls, folder: Path) -> DinoFeatures:
        """The network in `folder`. Raises CaptureError where there is none that can be used."""
        return cls(local_network(folder, _KINDS, "a DINOv2 or DINOv3"))

    def map_of(self, photograph: Photograph) -> np.ndarray:
        """(h, w, F) float32, one cell a patch."""
        height, width = photograph.mask.shape
        size = int(self.network.config.patch_size)
        rows, columns = (max(round(self.patches * side / max(height, width)), 1) for side in (height, width))
        rows, columns = min(rows, height), min(columns, width)
        picture = normalised(photograph.colour * photograph.mask[..., None], rows * size, columns * size)
        with torch.inference_mode():
            tokens = self.network(pixel_values=picture).last_hidden_state[0]
        # before the patches stand the token of the whole picture and the registers
        patches = tokens[len(tokens) - rows * columns :]
        patches = torch.nn.functional.normalize(patches, dim=1)
        return patches.reshape(rows, columns, -1).numpy().copy()
