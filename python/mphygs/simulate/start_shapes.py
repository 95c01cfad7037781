"""The state in which a motion that does not begin at rest begins: slow shapes, bent as far as they are.

Shapes are the slowest natural modes of the body in its holds, as if all of it were of one material: what they
are depends neither on what is fitted nor on the grid that is simulated, so that their amplitudes mean the
same everywhere. Far from rest a mode stretches what it should turn. The deformation is therefore composed as
F = exp(w) (I + e), with w the rotation and e the strain that the modes have linearly, and the displacement is
the one whose gradient is nearest to F, with held points where their holds are; the velocity is the rate of
it. Both are smooth functions of amplitudes and speeds.

Source: Huang, Tong, Zhou, Bao & Desbrun, "Interactive shape interpolation through controllable dynamic
deformation", IEEE Transactions on Visualization and Computer Graphics 17, 2011 (rotation-strain coordinates).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.sparse import bmat, csc_matrix, csr_matrix, diags, identity
from scipy.sparse.linalg import splu

from mphygs import _core
from mphygs.capture.format import Capture
from mphygs.capture.holds import Hold
from mphygs.model.belief import Belief, Parameter
from mphygs.scene.spacing_worth import spacing_worth
from mphygs.simulate.body import LANES, Body
from mphygs.simulate.discretisation import discretise
from mphygs.simulate.fields import core_inputs
from mphygs.simulate.modes import SOFT, lowest_modes
from mphygs.simulate.rows import held_rows

# Shapes that are known of a body, and cells that it is worth where they are computed.
SHAPES, CELLS = 12, 250
# Of the one material: shapes do not depend on its modulus [Pa] and density [kg/m^3].
MODULUS, RATIO, DENSITY = 1e5, 0.3, 1e3
# Inertia by axis: pairs of modes that a symmetric section leaves mixed are told apart.
INERTIA = np.array([1.0, 1.01, 1.03])
# Weight of the modes' own displacement beside the gradient: it says where a free body is, and bends nothing.
ANCHOR = 1e-6
# Steps: of complex differences, of those of a rate by a share of the largest amplitude, of a hold's pose [s].
_COMPLEX, _STEP, _POSE_STEP = 1e-20, 1e-5, 1e-4


@dataclass(frozen=True, eq=False)
class StartShapes:
    """shape: (N, 3, K) on the nodes of a body's grid [-], each one's largest displacement in the material 1;
    model: of that grid."""

    body: Body
    model: object
    shape: np.ndarray

    @property
    def count(self) -> int:
        """K, how many shapes there are."""
        return self.shape.shape[2]

    def at(self, points: np.ndarray, part: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Of points (P, 3) [m] of parts (P,): the shapes (P, 3, K) [-] and their gradient (P, 3, 3, K) [1/m],
        the derivative along X_j in [:, :, j]."""
        node, value, gradient = self.model.weights(points, self.body.nearest_cell(points, part))
        near = self.shape[node]
        return np.einsum("pn,pnck->pck", value, near), np.einsum("pnj,pnck->pcjk", gradient, near)


@lru_cache(maxsize=8)
def _shapes(capture: Capture, boxes: bytes) -> StartShapes:
    spacing = spacing_worth(capture.parts, CELLS)
    body = discretise(capture, np.frombuffer(boxes).reshape(-1, 2, 3), spacing)
    material = (("youngs_modulus", MODULUS), ("poissons_ratio", RATIO), ("density", DENSITY))
    alike = tuple(Parameter(f"{part}.{q}", value, "") for part in body.part_names for q, value in material)
    belief = Belief(body.part_names, np.zeros(3), alike)
    shape, _ = lowest_modes(body, core_inputs(belief, body), SHAPES, inertia=INERTIA)
    model = _grid_model(body)
    found = StartShapes(body, model, shape)
    value, _ = found.at(body.quadrature.points.reshape(-1, 3), np.repeat(body.quadrature.part, LANES))
    largest = np.linalg.norm(value, axis=1).argmax(0)
    peak = value[largest, :, np.arange(found.count)]
    # Which way is up is settled by a direction that no shape is across.
    sign = np.sign(peak @ np.sqrt([2.0, 3.0, 5.0]))
    return StartShapes(body, model, shape * sign / np.linalg.norm(peak, axis=1))


def _grid_model(body: Body) -> object:
    """A model that knows the nodes of a body's grid, and their weights."""
    return _core.TotalLagrangianFloat64(body.geometry, {"active": [], "law": "neo-hookean"})


def start_shapes(capture: Capture, boxes: np.ndarray) -> StartShapes:
    """The slowest shapes of a capture's body in its holds, kept. boxes: (H, 2, 3) of the holds [m].

    Raises ValueError where a hold touches no free material.
    """
    return _shapes(capture, np.ascontiguousarray(boxes, float).tobytes())


@dataclass(frozen=True, eq=False)
class HeldAt:
    """Poses of H holds at one time: rotation (H, 3, 3), shift (H, 3) [m], and the rates of both."""

    rotation: np.ndarray
    shift: np.ndarray
    turning: np.ndarray
    speed: np.ndarray

    @classmethod
    def of(cls, held: Sequence[Hold], time: float, fps: float) -> HeldAt:
        """At a time [s]; rates are those after it: before its first frame a hold is taken to stand."""
        times = time + _POSE_STEP * np.arange(3.0)
        poses = [hold.poses(times, fps) for hold in held]
        rotation = np.array([r for r, _ in poses]).reshape(-1, 3, 3, 3)
        shift = np.array([p for _, p in poses]).reshape(-1, 3, 3)
        ahead = np.array([-1.5, 2.0, -0.5]) / _POSE_STEP
        turning, speed = np.einsum("htij,t->hij", rotation, ahead), np.einsum("htj,t->hj", shift, ahead)
        return cls(rotation[:, 0], shift[:, 0], turning, speed)


class StartOnGrid:
    """Displacement and velocity on a grid's nodes, by amplitudes and speeds of the slowest shapes."""

    def __init__(self, shapes: StartShapes, body: Body) -> None:
        """body: on whose grid."""
        model = _grid_model(body)
        points = body.quadrature.points.reshape(-1, 3)
        node, value, gradient = model.weights(points, body.point_cell)
        self._value, self._gradient = shapes.at(points, np.repeat(body.quadrature.part, LANES))
        self._points = points
        count, volume = model.node_count, body.quadrature.volumes.ravel()
        begin = np.arange(0, node.size + 1, node.shape[1])

        def rows(weight: np.ndarray) -> csr_matrix:
            return csr_matrix((weight.ravel(), node.ravel(), begin), shape=(len(points), count))

        anchor = ANCHOR * volume / np.ptp(points, axis=0).max() ** 2
        slopes = [rows(gradient[:, :, j]) for j in range(3)]
        self._by_slope = [s.T.tocsr() @ diags(volume) for s in slopes]
        self._by_value = rows(value).T.tocsr() @ diags(anchor)
        matrix = sum(a @ s for a, s in zip(self._by_slope, slopes, strict=True)) + self._by_value @ rows(
            value
        )
        self._hold, self._target = body.geometry["row_hold"], body.geometry["row_target"]
        held = held_rows(body, model.node_index)
        scale = matrix.diagonal().mean()
        # What no point of the material sees stays put; rows that say the same twice do no harm.
        whole = matrix + 1e-12 * scale * identity(count)
        if held.shape[0]:
            soft = -SOFT * scale * identity(held.shape[0])
            whole = bmat([[whole, scale * held.T], [scale * held, soft]])
        self._scale = scale
        self._factors = splu(csc_matrix(whole))

    def _nearest(self, gradient: np.ndarray, value: np.ndarray, held: np.ndarray) -> np.ndarray:
        """(N, 3) field whose gradient is nearest to (P, 3, 3), else at (P, 3), with (R, 3) in its rows."""
        right = sum(a @ gradient[:, :, j] for j, a in enumerate(self._by_slope)) + self._by_value @ value
        found = self._factors.solve(np.concatenate([right, self._scale * held]))
        return found[: len(right)]

    def _modal(self, amplitude: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        count = len(amplitude)
        return self._gradient[..., :count] @ amplitude, self._value[..., :count] @ amplitude

    def _deformed(self, amplitude: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Deformation (P, 3, 3) and place (P, 3) [m] in the holds at rest."""
        gradient, value = self._modal(amplitude)
        return composed(gradient), self._points + value

    def _rate(self, amplitude: np.ndarray, speed: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Derivative of `_deformed` along a change of the amplitudes."""
        size = np.abs(speed).max(initial=0.0)
        if size == 0.0:
            return np.zeros_like(self._value[..., 0])[:, :, None] * np.zeros(3), self._modal(speed)[1]
        bent, _ = self._deformed(amplitude + 1j * _COMPLEX / size * speed)
        return bent.imag * (size / _COMPLEX), self._modal(speed)[1]

    def state(self, amplitude: np.ndarray, speed: np.ndarray, held: HeldAt) -> tuple[np.ndarray, np.ndarray]:
        """Displacement [m] and velocity [m/s] of the nodes, (N, 3). amplitude: (m,) [m], speed: (m,) [m/s] of
        the m slowest shapes."""
        bent, place = self._deformed(amplitude)
        rate, moving = self._rate(amplitude, speed)
        carried, swept = self._carried(held)
        r, p, turning, shifting = _frame(held)
        displacement = self._nearest(r @ bent - np.eye(3), place @ r.T + p - self._points, carried)
        velocity = self._nearest(
            r @ rate + turning @ bent, moving @ r.T + place @ turning.T + shifting, swept
        )
        return displacement, velocity

    def slopes(
        self, amplitude: np.ndarray, speed: np.ndarray, held: HeldAt
    ) -> list[tuple[np.ndarray, np.ndarray]]:
        """Derivatives of `state` by every amplitude, then by every speed."""
        still = np.zeros_like(self._target)
        r, _, turning, _ = _frame(held)
        step = _STEP * np.ptp(self._points, axis=0).max()
        by_amplitude, by_speed = [], []
        for unit in np.eye(len(amplitude)):
            bent, moved = self._rate(amplitude, unit)
            displacement = self._nearest(r @ bent, moved @ r.T, still)
            ends = [self._rate(amplitude + sign * step * unit, speed)[0] for sign in (1.0, -1.0)]
            change = (ends[0] - ends[1]) / (2.0 * step)
            velocity = self._nearest(r @ change + turning @ bent, moved @ turning.T, still)
            by_amplitude.append((displacement, velocity))
            by_speed.append((np.zeros_like(displacement), displacement))
        return by_amplitude + by_speed

    def _carried(self, held: HeldAt) -> tuple[np.ndarray, np.ndarray]:
        """Displacement and velocity of the rows, (R, 3): zero of those that tie parts."""
        moved, speed = np.zeros((2, *self._target.shape))
        for h in range(len(held.shift)):
            own = self._hold == h
            at = self._target[own]
            moved[own] = at @ held.rotation[h].T + held.shift[h] - at
            speed[own] = at @ held.turning[h].T + held.speed[h]
        return moved, speed


def _frame(held: HeldAt) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Rotation, shift and their rates of the first hold, in whose frame the body is bent."""
    if not len(held.shift):
        return np.eye(3), np.zeros(3), np.zeros((3, 3)), np.zeros(3)
    return held.rotation[0], held.shift[0], held.turning[0], held.speed[0]


def composed(gradient: np.ndarray) -> np.ndarray:
    """exp(w) (I + e), (..., 3, 3), of displacement gradients (..., 3, 3) whose rotation is w and strain e,
    real or complex."""
    transposed = np.swapaxes(gradient, -1, -2)
    spin, strain = 0.5 * (gradient - transposed), 0.5 * (gradient + transposed)
    square = (spin[..., 2, 1] ** 2 + spin[..., 0, 2] ** 2 + spin[..., 1, 0] ** 2)[..., None, None]
    small = np.abs(square) < 1e-6
    angle = np.sqrt(np.where(small, 1.0, square))
    sine = np.where(small, 1.0 - square / 6.0 + square**2 / 120.0, np.sin(angle) / angle)
    half = np.sin(0.5 * angle) / (0.5 * angle)
    cosine = np.where(small, 0.5 - square / 24.0 + square**2 / 720.0, 0.5 * half**2)
    return (np.eye(3) + sine * spin + cosine * (spin @ spin)) @ (np.eye(3) + strain)
