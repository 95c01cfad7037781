"""Trained networks from a local folder, through transformers; nothing is fetched."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
from safetensors import SafetensorError

from mphygs.capture.errors import fault

# Of the pictures that these networks were trained on (ImageNet).
MEAN, DEVIATION = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)


def local_network(folder: Path, kinds: dict[str, str], what: str) -> torch.nn.Module:
    """The network in `folder`, as transformers saved it, ready to be asked.

    kinds: model_type of its config.json -> name of the class in transformers; what: how messages name such a
    network. Raises CaptureError where transformers is not installed or the folder holds no such network.
    """
    try:
        import transformers
    except ImportError as error:
        raise fault(
            f"{what} in {folder}",
            "the package transformers is not installed",
            "pip install 'mphygs[networks]'",
        ) from error
    if not (folder / "config.json").is_file():
        raise fault(str(folder), "holds no config.json", f"a folder with {what}, as transformers saves it")
    try:
        config = transformers.AutoConfig.from_pretrained(folder, local_files_only=True)
        kind = str(config.model_type)
        if kind not in kinds:
            raise fault(str(folder), f'holds a network of type "{kind}"', f"one of {', '.join(kinds)}")
        network: Any = getattr(transformers, kinds[kind])
        return network.from_pretrained(folder, local_files_only=True).eval()
    except (OSError, ValueError, RuntimeError, SafetensorError) as error:
        raise fault(
            str(folder), f"cannot be loaded ({error})", f"{what}, as transformers saves it"
        ) from error


def normalised(colour: np.ndarray, height: int, width: int) -> torch.Tensor:
    """A picture (H, W, 3), 0 to 1, as a network takes it: (1, 3, height, width)."""
    way = cv2.INTER_AREA if colour.shape[0] > height else cv2.INTER_LINEAR
    sized = cv2.resize(colour.astype(np.float32), (width, height), interpolation=way)
    values = (sized - np.float32(MEAN)) / np.float32(DEVIATION)
    return torch.from_numpy(np.ascontiguousarray(values.transpose(2, 0, 1)))[None]
