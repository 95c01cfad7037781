"""The motion of a model as a torch operation, with its gradient by the numbers of the model."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, cast

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from mphygs.api.interface_errors import InputError, as_interface_errors
from mphygs.api.model import Model
from mphygs.capture.format import Sequence
from mphygs.simulate.prediction import Predictor
from mphygs.simulate.prediction_gradient import predict_with_gradient


class _Motion(torch.autograd.Function):
    """Positions, and the adjoint of a loss on them."""

    @staticmethod
    def forward(
        ctx: Any,
        model: Model,
        predictor: Predictor,
        keys: tuple[str, ...],
        last: int,
        substep: float | None,
        values: Tensor,
    ) -> Tensor:
        numbers = values.detach().to(torch.float64).tolist()
        moved = model.with_parameters(dict(zip(keys, numbers, strict=True)))
        with as_interface_errors():
            found = predictor.predict(moved.belief, last=last, substep=substep)
        ctx.run = (predictor, moved.belief, keys, last, substep, values.dtype)
        return torch.from_numpy(np.ascontiguousarray(found.position)).to(values.dtype)

    @staticmethod
    def backward(ctx: Any, *bars: Tensor) -> tuple[Tensor | None, ...]:
        predictor, belief, keys, last, substep, dtype = ctx.run
        bar = bars[0].detach().to(torch.float64).numpy()
        with as_interface_errors():
            _, slopes = predict_with_gradient(
                predictor, belief, lambda _: bar, keys=keys, last=last, substep=substep
            )
        # by the numbers themselves, not by their coordinates
        gradient = slopes / np.array([belief[key].slope for key in keys])
        return (None, None, None, None, None, torch.as_tensor(gradient, dtype=dtype))


def rollout(
    model: Model,
    parameters: Mapping[str, Tensor | float],
    sequence: str | Sequence | None = None,
    *,
    points: NDArray[np.floating] | None = None,
    frames: int | None = None,
    substep: float | None = None,
) -> Tensor:
    """Positions of points, (T, M, 3) [m], as a function of numbers of the model, differentiable once.

    parameters: key -> scalar tensor in the number's unit; what it does not name stays as the model has it.
    Gradients come from one checkpointed adjoint run, whatever their number. sequence, points, frames: see
    `simulate`; substep: at most so long [s], by default the stable one of the numbers given.
    Raises InputError for an unknown key, a value out of its bounds, or what is no scalar; FailedError for an
    unstable run. `mphygs.simulate.op.rollout` is the operation on fields of the grid below this one.
    """
    keys = tuple(parameters)
    values = [torch.as_tensor(value) for value in parameters.values()]
    for key, value in zip(keys, values, strict=True):
        if value.numel() != 1:
            shape = tuple(value.shape)
            raise InputError(f"parameter '{key}': got a tensor of shape {shape}; expected a scalar")
        if key not in model.belief:
            known = ", ".join(model.parameters)
            raise InputError(f"parameter '{key}' is not in the model; expected one of {known}")
    recording = model.recording(sequence, points)
    last = recording.frames if frames is None else frames
    if not 1 <= last <= recording.frames:
        raise InputError(f"frames: got {last}; expected 1 to {recording.frames} for {recording.name}")
    flat = [value.reshape(()).to(torch.float64) for value in values]
    given = torch.stack(flat) if flat else torch.zeros(0, dtype=torch.float64)
    with as_interface_errors():
        predictor = model.predictor(recording)
    return cast(Tensor, _Motion.apply(model, predictor, keys, last, substep, given))
