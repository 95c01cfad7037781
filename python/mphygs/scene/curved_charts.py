"""Charts of thin parts: where a curved grid, one cell through the thickness, lies in space."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial import cKDTree

_STEPS = np.indices((3, 3, 3)).reshape(3, -1).T - 1
# Points looked at together by Newton's method, its last step in cells and how often it is tried.
_POINTS_AT_ONCE, _TIGHT, _MOST = 20_000, 1e-8, 60
# Points whose sums over nodes are taken together: what these need stays in a cache.
_SUMMED_AT_ONCE = 512
# Places of a cell from which the search for a point may begin.
_BEGINNINGS = np.array([-1.0 / 3.0, 0.0, 1.0 / 3.0])


@dataclass(frozen=True, eq=False)
class Chart:
    """A grid of quadratic splines whose nodes stand where a thin part needs them.

    kind: "rod" or "shell"; control: (I, J, K, 3) places of the nodes, from node 0 on [m]; cells are numbered
    from 1 to the count of nodes less 2 along every axis. A place is X(s) = sum_a N_a(s) control_a, s in
    cells: node i lies at i, cell i is [i - 1/2, i + 1/2]. Beyond the cells the last one's polynomial goes on.
    Source: isoparametric splines, Hughes, Cottrell, Bazilevs 2005.
    """

    kind: str
    control: np.ndarray

    @property
    def count(self) -> np.ndarray:
        """(3,) cells along each axis."""
        return np.array(self.control.shape[:3]) - 2

    @property
    def nodes(self) -> np.ndarray:
        """(N, 3) numbers of all nodes, in the order of `control`."""
        return np.indices(self.control.shape[:3]).reshape(3, -1).T

    @property
    def thin(self) -> int:
        """Axes that one cell spans: the last two of a rod, the last of a shell."""
        return 2 if self.kind == "rod" else 1

    def cell_of(self, s: np.ndarray) -> np.ndarray:
        """(M, 3) cells of coordinates (M, 3), the nearest where these lie beyond."""
        return np.clip(np.rint(s).astype(np.int64), 1, self.count)

    def to_space(self, s: np.ndarray) -> np.ndarray:
        """(M, 3) places [m] of coordinates (M, 3) [cells]."""
        return self._sums(s, (0,))[:, 0]

    def jacobian(self, s: np.ndarray) -> np.ndarray:
        """(M, 3, 3) dX/ds at coordinates (M, 3) [m]."""
        return np.swapaxes(self._sums(s, (1, 2, 3)), 1, 2)

    def _at(self, s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Places and slopes, as `to_space` and `jacobian` give them."""
        sums = self._sums(s, (0, 1, 2, 3))
        return sums[:, 0], np.swapaxes(sums[:, 1:], 1, 2)

    def _sums(self, s: np.ndarray, wanted: Sequence[int]) -> np.ndarray:
        """(M, W, 3) places (0) and slopes along the axes (1, 2, 3), as wanted, at coordinates (M, 3)."""
        found = np.empty((len(s), len(wanted), 3))
        nodes = self.control.reshape(-1, 3)
        stride = np.array([self.control.shape[1] * self.control.shape[2], self.control.shape[2], 1])
        around = _STEPS @ stride
        for start in range(0, len(s), _SUMMED_AT_ONCE):
            some = s[start : start + _SUMMED_AT_ONCE]
            cell = self.cell_of(some)
            own = (some - cell).T
            value = np.stack([0.5 * (0.5 - own) ** 2, 0.75 - own**2, 0.5 * (0.5 + own) ** 2])  # (3, 3, m)
            slope = np.stack([own - 0.5, -2.0 * own, own + 0.5])
            weight = np.empty((len(some), len(wanted), 27))
            for at, k in enumerate(wanted):
                x, y, z = (slope[:, c] if k == c + 1 else value[:, c] for c in range(3))
                plane = x[:, None] * y[None]
                weight[:, at] = (plane[:, :, None] * z).reshape(27, -1).T
            found[start : start + len(some)] = weight @ nodes[(cell @ stride)[:, None] + around]
        return found

    @cached_property
    def _beginnings(self) -> tuple[cKDTree, np.ndarray]:
        axes = [(np.arange(1, n + 1)[:, None] + _BEGINNINGS).ravel() for n in self.count]
        s = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
        return cKDTree(self.to_space(s)), s

    def to_cells(self, points: np.ndarray) -> np.ndarray:
        """(..., 3) coordinates [cells] of places (..., 3) [m], by Newton's method from the nearest of some.

        A place far off the part gets the coordinates that the search ended at.
        """
        flat = np.asarray(points, float).reshape(-1, 3)
        tree, begin = self._beginnings
        found = np.empty_like(flat)
        for start in range(0, len(flat), _POINTS_AT_ONCE):
            some = flat[start : start + _POINTS_AT_ONCE]
            found[start : start + len(some)] = self._searched(some, begin[tree.query(some)[1]])
        return found.reshape(np.shape(points))

    def _searched(self, points: np.ndarray, s: np.ndarray) -> np.ndarray:
        s = s.copy()
        going = np.arange(len(points))
        for _ in range(_MOST):
            place, jacobian = self._at(s[going])
            singular = np.abs(np.linalg.det(jacobian)) <= 0.0
            jacobian[singular] = np.eye(3)
            step = np.linalg.solve(jacobian, (points[going] - place)[..., None])[..., 0]
            size = np.abs(step).max(axis=1)
            step *= np.minimum(1.0, 0.5 / np.maximum(size, 1e-300))[:, None]
            step[singular] = 0.0
            s[going] = np.clip(s[going] + step, -1.5, self.count + 2.5)
            going = going[(size > _TIGHT) & ~singular]
            if not len(going):
                break
        return s

    def check(self, name: str) -> None:
        """Raises ValueError where the chart turns inside out: the part folds onto itself."""
        axes = [np.linspace(0.5, n + 0.5, 2 * n + 1) for n in self.count]
        s = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
        bad = np.linalg.det(self.jacobian(s)) <= 0.0
        if bad.any():
            where = self.to_space(s[bad]).mean(axis=0)
            raise ValueError(
                f"part '{name}': as a {self.kind} it folds onto itself near {np.round(where, 4).tolist()} m, "
                "expected it to bend over more than its own width, or \"as\": \"solid\""
            )
