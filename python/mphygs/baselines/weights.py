"""Weights of a network, from numbers and as tensors."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np
import torch
from torch import Tensor


def as_tensors(
    values: Mapping[str, np.ndarray], names: Iterable[str], *, slopes: bool = False
) -> dict[str, Tensor]:
    """The values of these names in float32. slopes: whether each collects its gradient."""
    found = {name: torch.as_tensor(values[name], dtype=torch.float32) for name in names}
    return {name: t.clone().requires_grad_() if slopes else t for name, t in found.items()}
