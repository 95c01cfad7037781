"""The chart of a shell: splines through its middle surface, and half its thickness to either side."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix, identity, kron, vstack
from scipy.sparse.linalg import splu

from mphygs.scene.curved_charts import Chart
from mphygs.scene.middle_surface import MiddleSurface

# Weight of a cell's second differences beside the samples of a cell: they say how the chart goes on where
# there are none.
_SMOOTH = 1e-4
# How often surface and coordinates are found from each other.
_ROUNDS = 3


def shell_chart(surface: MiddleSurface, low: np.ndarray, spacing: np.ndarray, count: np.ndarray) -> Chart:
    """Cells of a shell. low: (2,) where the first begins in the surface's coordinates [m]; spacing: (2,) [m];
    count: (2,) of cells.

    The chart follows the middle surface as its splines can, smoothed; it need not meet it: material is
    where the mesh is, and the chart only says how it is told.
    """
    shape = np.asarray(count) + 2
    s = (surface.flat - low) / spacing + 0.5
    smooth = _second_differences(shape)
    for _ in range(_ROUNDS):
        weight = _weights(s, shape)
        square = (weight.T @ weight + _SMOOTH * len(s) / np.prod(count) * smooth).tocsc()
        solver = splu(square)
        middle = solver.solve(weight.T @ surface.place).reshape(*shape, 3)
        s = s + _missed(middle, s, surface.place)
    thickness = solver.solve(weight.T @ surface.thickness).reshape(shape)
    thickness = np.clip(thickness, surface.thickness.min(), surface.thickness.max())
    node = np.indices(shape).reshape(2, -1).T.astype(float)
    along = _slopes(middle, np.clip(node, 0.5, np.asarray(count) + 0.5))
    normal = np.cross(along[:, 0], along[:, 1])
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    step = thickness.reshape(-1, 1) * normal
    flat = middle.reshape(-1, 3)
    control = np.stack([flat - step, flat, flat + step], axis=1)
    return Chart("shell", control.reshape(*shape, 3, 3))


def _stencils(s: np.ndarray, shape: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Cells (n, 2) of coordinates (n, 2), values and slopes (n, 2, 3) of the splines there."""
    cell = np.clip(np.rint(s).astype(np.int64), 1, shape - 2)
    own = s - cell
    value = np.stack([0.5 * (0.5 - own) ** 2, 0.75 - own**2, 0.5 * (0.5 + own) ** 2], axis=2)
    slope = np.stack([own - 0.5, -2.0 * own, own + 0.5], axis=2)
    return cell, value, slope


def _weights(s: np.ndarray, shape: np.ndarray) -> csr_matrix:
    cell, value, _ = _stencils(s, shape)
    node = cell[:, :, None] + np.arange(-1, 2)
    number = node[:, 0, :, None] * shape[1] + node[:, 1, None, :]
    weight = value[:, 0, :, None] * value[:, 1, None, :]
    row = np.repeat(np.arange(len(s)), 9)
    return csr_matrix((weight.ravel(), (row, number.ravel())), shape=(len(s), int(np.prod(shape))))


def _slopes(middle: np.ndarray, s: np.ndarray) -> np.ndarray:
    """(n, 2, 3) dM/ds."""
    cell, value, slope = _stencils(s, np.array(middle.shape[:2]))
    node = cell[:, :, None] + np.arange(-1, 2)
    control = middle[node[:, 0, :, None], node[:, 1, None, :]]  # (n, 3, 3, 3)
    return np.stack(
        [
            np.einsum("nijc,ni,nj->nc", control, slope[:, 0], value[:, 1]),
            np.einsum("nijc,ni,nj->nc", control, value[:, 0], slope[:, 1]),
        ],
        axis=1,
    )


def _missed(middle: np.ndarray, s: np.ndarray, place: np.ndarray) -> np.ndarray:
    """How far along the surface its places at s are from where they should be, in cells."""
    shape = np.array(middle.shape[:2])
    cell, value, _ = _stencils(s, shape)
    node = cell[:, :, None] + np.arange(-1, 2)
    control = middle[node[:, 0, :, None], node[:, 1, None, :]]
    gap = place - np.einsum("nijc,ni,nj->nc", control, value[:, 0], value[:, 1])
    along = _slopes(middle, s)
    square = np.einsum("nac,nbc->nab", along, along)
    return np.linalg.solve(square, np.einsum("nac,nc->na", along, gap)[..., None])[..., 0]


def _second_differences(shape: np.ndarray) -> csr_matrix:
    """Sum of squares of second differences along both axes and of the mixed ones, as a matrix."""
    one, two = ((identity(n, format="csr")[1:] - identity(n, format="csr")[:-1]) for n in shape)
    rows = [kron(one[1:, 1:] @ one, identity(shape[1])), kron(identity(shape[0]), two[1:, 1:] @ two)]
    rows.append(np.sqrt(2.0) * kron(one, two))
    all_rows = vstack(rows)
    return (all_rows.T @ all_rows).tocsr()
