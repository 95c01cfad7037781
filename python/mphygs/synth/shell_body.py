"""A sheet under a hold, and what acts on it: control points of its middle."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.sparse import csc_matrix, csr_matrix

from mphygs.capture.format import Capture
from mphygs.capture.record import Sequence as Recording
from mphygs.synth.causes import CAUSES, MaterialState
from mphygs.synth.implicit_motion import summed_blocks
from mphygs.synth.outside_forces import body_field, drag, tether
from mphygs.synth.shell_grid import ShellGrid
from mphygs.synth.shell_strain import fundamental, local_axes, normal, slope_forces

if TYPE_CHECKING:
    from mphygs.synth.hidden import Hidden
    from mphygs.synth.recipe import Recipe

KNOWN = (
    "gravity", "mass_damping", "air_drag", "wind", "attached_mass", "tether", "base_motion", "viscosity",
    "compressibility", "stiffness_gradient", "density_gradient",
)  # fmt: skip
# By what forces are differentiated, of the slopes at rest; rows of control points that a hold grips: these
# fix place and slope of the edge.
NUDGE, GRIPPED = 1e-6, 2
SAME = 1e-9


class Feet(NamedTuple):
    """Material points `at` (M, 3) at rest [m]: control points (M, 16), shares (M, 3, 16) of the place and of
    two slopes at their feet, height (M,) above there [m]; held: (M,) bool."""

    at: np.ndarray
    control: np.ndarray
    shares: np.ndarray
    height: np.ndarray
    held: np.ndarray


class ShellBody:
    """The sheet of a recipe's shape under the hold of a recording. size: of its elements [m], at most."""

    def __init__(
        self, capture: Capture, recording: Recording, recipe: Recipe, hidden: Sequence[Hidden], size: float
    ) -> None:
        self.recording, (self.hold,) = recording, recording.held
        sheet = recipe.shape.sheet
        assert sheet is not None
        self.effects = {h.name: h.values for h in hidden if h.kind == "effect"}
        terms = {h.name: h for h in hidden if h.kind == "effect"}
        self.grid = grid = ShellGrid.over(sheet, size)
        at, weight = grid.quadrature()
        index, shares = grid.shapes(at)
        self._shares = shares[:, 1:]
        # What takes control points to the quadrature points and to their slopes.
        row = np.broadcast_to(np.arange(6 * len(at)).reshape(-1, 6, 1), shares.shape)
        column = np.broadcast_to(index[:, None], shares.shape)
        whole = csr_matrix((shares.ravel(), (row.ravel(), column.ravel())), (6 * len(at), len(grid.control)))
        self._value = whole[0::6]
        self._derivative = whole[np.arange(6 * len(at)) % 6 > 0]
        self._to_value, self._to_derivative = self._value.T.tocsr(), self._derivative.T.tocsr()
        self.points, slopes = self._value @ grid.control, self._slopes(grid.control)
        self._axes, area = local_axes(slopes)
        self._area, self._rest = weight * area, fundamental(slopes)
        self._nudge = NUDGE * np.linalg.norm(slopes[:, :2], axis=2).mean()
        (name,) = recipe.shape.part_names
        material, thick = recipe.materials[name], sheet.thickness

        def slope(of: str) -> np.ndarray:
            if of not in terms:
                return np.zeros(len(weight))
            axis = np.asarray(terms[of].settings["axis"], float)
            middle = self._area @ self.points / self._area.sum()
            return self.effects[of]["slope"] * (self.points - middle) @ (axis / np.linalg.norm(axis))

        youngs = material.youngs_modulus * np.exp(slope("stiffness_gradient"))
        ratio = self.effects.get("compressibility", {}).get("nu", material.poissons_ratio)
        plane = np.array([[1.0, ratio, 0.0], [ratio, 1.0, 0.0], [0.0, 0.0, 0.5 * (1.0 - ratio)]])
        elastic = youngs[:, None, None] * plane / (1.0 - ratio**2)
        # Twice eta times the deviator of the rate, of a sheet whose thickness follows by Poisson's ratio.
        eta = self.effects.get("viscosity", {}).get("eta", 0.0)
        both = (ratio**2 - (1.0 - 2.0 * ratio) ** 2 / 3.0) / (1.0 - ratio) ** 2
        viscous = 2.0 * eta * (np.diag([1.0, 1.0, 0.5]) + both * np.outer([1.0, 1.0, 0.0], [1.0, 1.0, 0.0]))
        self._elastic = self._stiffness(elastic, thick)
        self._viscous = self._stiffness(np.broadcast_to(viscous, elastic.shape), thick)
        density = material.density * np.exp(slope("density_gradient"))
        self.mass, self.volume = density * thick * self._area, thick * self._area
        # Both faces and, shared out, the rim; of the part that is not held as of all of it.
        self.surface = self.volume * capture.parts[0].area / capture.parts[0].volume
        count = np.arange(len(grid.control))
        self.held = count < GRIPPED * (grid.counts[1] + 3)
        self._spots = {
            n: self.places(np.array([t.settings["place"]])) for n, t in terms.items() if "place" in t.settings
        }
        self.gravity = np.asarray(capture.gravity, float)
        self._entry = (3 * index.reshape(-1, 16, 16)[:, 0, :, None] + np.arange(3)).reshape(-1, 48)
        self.inertia = self._inertia(shares[:, 0].reshape(-1, 16, 16))
        self._causes = [h for h in hidden if h.kind == "cause"]
        self._loads = [
            (self._share(load.box)[:, None] * load.force, load.start_frame / recording.fps,
             math.inf if load.end_frame is None else load.end_frame / recording.fps)
            for load in recording.loads
        ]  # fmt: skip

    def _stiffness(self, plane: np.ndarray, thick: float) -> np.ndarray:
        """(Q, 6, 6) by what `fundamental` gives, of (Q, 3, 3) in square axes [Pa], per area of the middle."""
        turned = np.swapaxes(self._axes, 1, 2) @ plane @ self._axes
        out = np.zeros((len(turned), 6, 6))
        out[:, :3, :3], out[:, 3:, 3:] = thick * turned, thick**3 / 12.0 * turned
        return out

    def _inertia(self, value: np.ndarray) -> csc_matrix:
        """Of shares (E, 16, 16) of the control points at the elements' points."""
        mass = np.einsum("eq,eqi,eqj->eij", self.mass.reshape(-1, 16), value, value)
        blocks = np.einsum("eij,cd->eicjd", mass, np.eye(3)).reshape(-1, 48, 48)
        inertia = summed_blocks(blocks, self._entry, 3 * len(self.held))
        if "attached_mass" in self._spots:
            spot, mass = self._spots["attached_mass"], self.effects["attached_mass"]["m"]
            own = mass * np.outer(spot.shares[0, 0], spot.shares[0, 0])
            block = np.einsum("ij,cd->icjd", own, np.eye(3)).reshape(1, 48, 48)
            entry = (3 * spot.control[0][:, None] + np.arange(3)).reshape(1, 48)
            inertia = inertia + summed_blocks(block, entry, 3 * len(self.held))
        return csc_matrix(inertia)

    def _share(self, box: np.ndarray) -> np.ndarray:
        """(Q,) of the points in a box, by volume."""
        share = self.volume * ((self.points >= box[0]) & (self.points <= box[1])).all(axis=1)
        return share / share.sum()

    # ---- places -------------------------------------------------------------------------------
    def places(self, points: np.ndarray) -> Feet:
        """What carries material points (M, 3) [m]."""
        control, shares = self.grid.shapes(self.grid.feet(points))
        at = np.einsum("moi,mic->moc", shares[:, :3], self.grid.control[control])
        up, _ = normal(at[:, 1:])
        low, high = self.hold.box
        held = ((points >= low - SAME) & (points <= high + SAME)).all(axis=1)
        return Feet(points, control, shares[:, :3], np.einsum("mc,mc->m", points - at[:, 0], up), held)

    def carried(
        self, feet: Feet, place: np.ndarray, velocity: np.ndarray, time: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Where material points are (M, 3) [m] and how fast they move (M, 3) [m/s]; on normals, or held."""
        speed, step = velocity.copy(), 1e-4
        turn, shift = self.hold.poses(np.array([time, time - step, time + step]), self.recording.fps)
        rate, drift = (turn[2] - turn[1]) / (2.0 * step), (shift[2] - shift[1]) / (2.0 * step)
        speed[self.held] = self.grid.control[self.held] @ rate.T + drift
        at, going = (np.einsum("moi,mic->moc", feet.shares, v[feet.control]) for v in (place, speed))
        up, size = normal(at[:, 1:])
        turning = np.cross(going[:, 1], at[:, 2]) + np.cross(at[:, 1], going[:, 2])
        turning = (turning - np.einsum("mc,mc->m", turning, up)[:, None] * up) / size[:, None]
        found, moving = (a[:, 0] + feet.height[:, None] * b for a, b in ((at, up), (going, turning)))
        found[feet.held] = feet.at[feet.held] @ turn[0].T + shift[0]
        moving[feet.held] = feet.at[feet.held] @ rate.T + drift
        return found, moving

    # ---- what `march` asks for ----------------------------------------------------------------
    def at_rest(self) -> np.ndarray:
        """Control points (N, 3) at rest [m]."""
        return self.grid.control

    def moved(self, state: np.ndarray, change: np.ndarray) -> np.ndarray:
        """The state after displacements (N, 3) [m]."""
        return state + change

    def imposed(self, state: np.ndarray, time: float) -> np.ndarray:
        """The state with what is gripped where its hold is."""
        (turn,), (shift,) = self.hold.poses(np.array([time]), self.recording.fps)
        return np.where(self.held[:, None], self.grid.control @ turn.T + shift, state)

    def surplus(
        self, state: np.ndarray, velocity: np.ndarray, before: np.ndarray, time: float, step: float
    ) -> np.ndarray:
        """(N, 3) internal less external forces [N]."""
        slopes = self._slopes(state)
        inside = self._area[:, None, None] * slope_forces(slopes, self._stress(slopes, before, step))
        x, v = self._value @ state, self._value @ velocity
        force = self.mass[:, None] * body_field(self.gravity, v, time, self.effects)
        force = force + drag(v, self.surface, self.effects)
        for thing in self._causes:
            everywhere, still = np.ones(len(x), bool), np.tile(np.eye(3), (len(x), 1, 1))
            points = MaterialState(self.points, x, v, still, self.mass, self.volume, everywhere, time)
            force = force + CAUSES[thing.name].function(points, thing.values)[0]
        for pull, begin, end in self._loads:
            # Of the step in which it starts or ends, by its middle.
            if begin <= time - 0.5 * step < end:
                force = force + pull
        out = self._to_derivative @ inside.reshape(-1, 3) - self._to_value @ force
        for name, spot in self._spots.items():
            share, own = spot.shares[0, 0][:, None], spot.control[0]
            if name == "tether":
                out[own] -= share * tether((share * state[own]).sum(0, keepdims=True), self.effects[name])
            elif name == "attached_mass":
                speed = (share * velocity[own]).sum(0)
                weight = self.effects[name]["m"] * body_field(self.gravity, speed, time, self.effects)
                out[own] -= share * weight
        return out

    def slope(self, state: np.ndarray, before: np.ndarray, step: float) -> csc_matrix:
        """(3 N, 3 N) of the internal forces, by differences at the quadrature points."""
        slopes = self._slopes(state)
        plain = slope_forces(slopes, self._stress(slopes, before, step))
        size = self._nudge
        columns = []
        for k in range(15):
            nudged = slopes.copy()
            nudged[:, k // 3, k % 3] += size
            change = slope_forces(nudged, self._stress(nudged, before, step)) - plain
            columns.append(change.reshape(-1, 15) / size)
        both = (self._area[:, None, None] * np.stack(columns, axis=2)).reshape(-1, 5, 3, 5, 3)
        # Of a point first by its row's control points, then by its column's; points of an element add up.
        across = np.swapaxes(self._shares, 1, 2)
        half = (across @ both.reshape(-1, 5, 45)).reshape(-1, 16, 3, 5, 3)
        half = half.transpose(0, 3, 1, 2, 4).reshape(-1, 5, 144)
        whole = (across @ half).reshape(-1, 16, 16, 16, 3, 3).sum(axis=1)
        blocks = whole.transpose(0, 2, 3, 1, 4)
        return summed_blocks(blocks.reshape(-1, 48, 48), self._entry, 3 * len(state))

    # ---- stress -------------------------------------------------------------------------------
    def _slopes(self, state: np.ndarray) -> np.ndarray:
        """(Q, 5, 3) of the middle surface."""
        return (self._derivative @ state).reshape(-1, 5, 3)

    def _stress(self, slopes: np.ndarray, before: np.ndarray, step: float) -> np.ndarray:
        """(Q, 6) by what `fundamental` gives, elastic and, over a step [s], viscous."""
        now = fundamental(slopes)
        stress = (self._elastic @ (now - self._rest)[..., None])[..., 0]
        if "viscosity" in self.effects:
            rate = (now - fundamental(self._slopes(before))) / step
            stress = stress + (self._viscous @ rate[..., None])[..., 0]
        return stress
