"""Rods under holds, and what acts on them: nodes of a place and a rotation each."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.sparse import csc_matrix

from mphygs.capture.format import Capture
from mphygs.capture.record import Sequence as Recording
from mphygs.capture.rotation import matrix_from_rotation_vector
from mphygs.synth.causes import CAUSES, MaterialState
from mphygs.synth.implicit_motion import summed_blocks
from mphygs.synth.outside_forces import body_field, drag, tether
from mphygs.synth.rod_net import SAME, rod_net
from mphygs.synth.rod_strain import nodal_forces, strains

if TYPE_CHECKING:
    from mphygs.synth.hidden import Hidden
    from mphygs.synth.recipe import Recipe

KNOWN = (
    "gravity", "mass_damping", "air_drag", "wind", "attached_mass", "tether", "base_motion", "viscosity",
    "compressibility", "stiffness_gradient", "density_gradient",
)  # fmt: skip
# By what forces are differentiated, to both sides [m, rad]: to one, bending far softer than stretching would
# be lost in what stretching leaves.
NUDGE = 1e-7


class RodState(NamedTuple):
    """place: (N, 3) [m]; rotation: (N, 3, 3) from rest."""

    place: np.ndarray
    rotation: np.ndarray


class Places(NamedTuple):
    """Material points (M, 3) [m] on elements (M,), `share` (M,) of the way from the first node to the second,
    `aside` (M, 3) [m] of there; held: (M,) bool."""

    element: np.ndarray
    share: np.ndarray
    aside: np.ndarray
    held: np.ndarray


class RodBody:
    """Rods of a recipe's shape under the holds of a recording. spacing: of the nodes [m], at most."""

    def __init__(
        self, capture: Capture, recording: Recording, recipe: Recipe, hidden: Sequence[Hidden], spacing: float
    ) -> None:
        self.recording = recording
        self.effects = {h.name: h.values for h in hidden if h.kind == "effect"}
        terms = {h.name: h for h in hidden if h.kind == "effect"}
        lines, boxes = recipe.shape.lines, np.array([hold.box for hold in recording.held])
        self.net = net = rod_net(lines, boxes, spacing)
        self._rest = net.nodes[net.element[:, 1]] - net.nodes[net.element[:, 0]]
        names = recipe.shape.part_names
        part = np.array([line.part for line in lines])[net.line]
        sections = [lines[k].section for k in net.line]
        materials = [recipe.materials[names[p]] for p in part]
        middle = net.nodes[net.element].mean(axis=1)

        def slope(name: str) -> np.ndarray:
            if name not in terms:
                return np.zeros(len(part))
            own = part == names.index(str(terms[name].settings["part"]))
            axis = np.asarray(terms[name].settings["axis"], float)
            volume = own * net.length * [s.area for s in sections]
            arm = (middle - volume @ middle / volume.sum()) @ (axis / np.linalg.norm(axis))
            return self.effects[name]["slope"] * np.where(own, arm, 0.0)

        youngs = np.array([m.youngs_modulus for m in materials]) * np.exp(slope("stiffness_gradient"))
        ratio = np.array([m.poissons_ratio for m in materials])
        if "compressibility" in self.effects:
            ratio = np.full(len(part), self.effects["compressibility"]["nu"])
        self.stiffness = np.array(
            [s.stiffness(e, n) for s, e, n in zip(sections, youngs, ratio, strict=True)]
        )
        # Stress by the rate of strain over that by strain [s]: 2 eta times the deviator of the rate, of a
        # stretch whose sides narrow by Poisson's ratio 4/3 (1 + nu)^2 eta, of a shear eta.
        eta = self.effects.get("viscosity", {}).get("eta", 0.0)
        along, across = 4.0 / 3.0 * (1.0 + ratio) ** 2 * eta / youngs, 2.0 * (1.0 + ratio) * eta / youngs
        self.lag = np.stack([along, across, across, across, along, along], axis=1)
        density = np.array([m.density for m in materials]) * np.exp(slope("density_gradient"))
        self._weigh(density, sections)
        self.held = np.zeros(len(net.nodes), bool)
        self.gripped = [self._within(box) for box in boxes]
        for within in self.gripped:
            self.held |= within
        self._spots = {
            n: self.places(np.array([t.settings["place"]]))._replace(aside=np.zeros((1, 3)))
            for n, t in terms.items()
            if "place" in t.settings
        }
        if "attached_mass" in self._spots:
            at, values = self._spots["attached_mass"], self.effects["attached_mass"]
            share = np.array([1.0 - at.share[0], at.share[0]])
            np.add.at(self.mass, net.element[at.element[0]], values["m"] * share)
        self.inertia = self._inertia()
        self.gravity = np.asarray(capture.gravity, float)
        self._causes = [(h, self._of_part(h, part, names)) for h in hidden if h.kind == "cause"]
        self._loads = [
            (self._share(load.box)[:, None] * load.force, load.start_frame / recording.fps,
             math.inf if load.end_frame is None else load.end_frame / recording.fps)
            for load in recording.loads
        ]  # fmt: skip
        entry = 6 * net.element[:, :, None] + np.arange(6)
        self._entry = entry.reshape(len(entry), 12)

    def _weigh(self, density: np.ndarray, sections: Sequence) -> None:
        """Mass (N,) [kg], inertia (N, 3, 3) [kg m^2] in rest's axes, volume [m^3], surface [m^2] of nodes."""
        net = self.net
        area, second, outline = (
            np.array([getattr(s, n) for s in sections]) for n in ("area", "second", "outline")
        )
        half = 0.5 * net.length
        # Two of the three lie in the section; about the rod it turns as both of them.
        turning = np.einsum(
            "eik,ek,ejk->eij", net.frame, second[:, None] * np.array([2.0, 1.0, 1.0]), net.frame
        )
        self.mass, self.volume, self.surface = (np.zeros(len(net.nodes)) for _ in range(3))
        self.turning = np.zeros((len(net.nodes), 3, 3))
        for side in (0, 1):
            node = net.element[:, side]
            np.add.at(self.mass, node, density * half * area)
            np.add.at(self.volume, node, half * area)
            np.add.at(self.surface, node, half * outline)
            np.add.at(self.turning, node, (density * half)[:, None, None] * turning)
        # Where a rod ends its section is bare.
        ends = np.bincount(net.element.ravel(), minlength=len(net.nodes)) == 1
        for side in (0, 1):
            node = net.element[:, side]
            np.add.at(self.surface, node, np.where(ends[node], area, 0.0))

    def _inertia(self) -> csc_matrix:
        blocks = np.zeros((len(self.mass), 6, 6))
        blocks[:, [0, 1, 2], [0, 1, 2]] = self.mass[:, None]
        blocks[:, 3:, 3:] = self.turning
        entry = 6 * np.arange(len(blocks))[:, None] + np.arange(6)
        return summed_blocks(blocks, entry, 6 * len(blocks))

    def _within(self, box: np.ndarray) -> np.ndarray:
        return ((self.net.nodes >= box[0] - SAME) & (self.net.nodes <= box[1] + SAME)).all(axis=1)

    def _share(self, box: np.ndarray) -> np.ndarray:
        """(N,) of the nodes in a box, by the volume about them."""
        share = self.volume * self._within(box)
        return share / share.sum()

    def _of_part(self, thing: Hidden, part: np.ndarray, names: Sequence[str]) -> np.ndarray:
        """(N,) bool: nodes of the part that a cause acts on, of all where it names none."""
        if "part" not in thing.settings:
            return np.ones(len(self.net.nodes), bool)
        chosen = self.net.element[part == names.index(str(thing.settings["part"]))]
        return np.isin(np.arange(len(self.net.nodes)), chosen)

    # ---- places -------------------------------------------------------------------------------
    def places(self, points: np.ndarray) -> Places:
        """What carries material points (M, 3) [m]: the place nearest to each."""
        first = self.net.nodes[self.net.element[:, 0]]
        away = points[:, None] - first
        share = np.einsum("mec,ec->me", away, self._rest) / self.net.length**2
        share = np.clip(share, 0.0, 1.0)
        aside = away - share[:, :, None] * self._rest
        element = np.linalg.norm(aside, axis=2).argmin(axis=1)
        row = np.arange(len(points))
        held = self.held[self.net.element[element]].all(axis=1)
        return Places(element, share[row, element], aside[row, element], held)

    def carried(
        self, at: Places, state: RodState, velocity: np.ndarray, time: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Where material points are (M, 3) [m] and how fast they move (M, 3) [m/s].

        Both are blended between two nodes, each of which carries the point as a rigid body.
        """
        velocity = self._gripped(velocity, time, state)
        place, speed = np.zeros(at.aside.shape), np.zeros(at.aside.shape)
        for side, weight in ((0, 1.0 - at.share), (1, at.share)):
            node = self.net.element[at.element, side]
            turned = np.einsum("mij,mj->mi", state.rotation[node], at.aside)
            spin = np.cross(velocity[node, 3:], at.aside)
            place += weight[:, None] * (state.place[node] + turned)
            speed += weight[:, None] * (
                velocity[node, :3] + np.einsum("mij,mj->mi", state.rotation[node], spin)
            )
        return place, speed

    # ---- what `march` asks for ----------------------------------------------------------------
    def at_rest(self) -> RodState:
        """All nodes where they are at rest."""
        return RodState(self.net.nodes, np.tile(np.eye(3), (len(self.net.nodes), 1, 1)))

    def moved(self, state: RodState, change: np.ndarray) -> RodState:
        """The state after displacements and turns (N, 6) in the nodes' own axes."""
        turn = matrix_from_rotation_vector(change[:, 3:])
        return RodState(state.place + change[:, :3], state.rotation @ turn)

    def _gripped(self, velocity: np.ndarray, time: float, state: RodState) -> np.ndarray:
        """Velocities (N, 6) with those of the holds in place of what is gripped."""
        out, step = velocity.copy(), 1e-4
        for hold, within in zip(self.recording.held, self.gripped, strict=True):
            turn, shift = hold.poses(np.array([time - step, time + step]), self.recording.fps)
            rate = (turn[1] - turn[0]) / (2.0 * step)
            out[within, :3] = self.net.nodes[within] @ rate.T + (shift[1] - shift[0]) / (2.0 * step)
            spin = np.swapaxes(state.rotation[within], 1, 2) @ rate
            out[within, 3:] = np.stack([spin[:, 2, 1], spin[:, 0, 2], spin[:, 1, 0]], axis=1)
        return out

    def imposed(self, state: RodState, time: float) -> RodState:
        """The state with what is gripped where its holds are."""
        place, rotation = state.place.copy(), state.rotation.copy()
        for hold, within in zip(self.recording.held, self.gripped, strict=True):
            (turn,), (shift,) = hold.poses(np.array([time]), self.recording.fps)
            place[within], rotation[within] = self.net.nodes[within] @ turn.T + shift, turn
        return RodState(place, rotation)

    def surplus(
        self, state: RodState, velocity: np.ndarray, before: RodState, time: float, step: float
    ) -> np.ndarray:
        """(N, 6) internal less external forces [N] and torques [N m], the gyroscopic among them."""
        stiffness, late = self._lagging(before, step)
        inside = self._forces(
            state.place[self.net.element], state.rotation[self.net.element], stiffness, late
        )
        out = np.zeros((len(self.mass), 6))
        np.add.at(out, self.net.element, inside)
        x, v, spin = state.place, velocity[:, :3], velocity[:, 3:]
        out[:, :3] -= self._outside(x, v, time, step)
        out[:, 3:] += np.cross(spin, np.einsum("nij,nj->ni", self.turning, spin))
        return out

    def slope(self, state: RodState, before: RodState, step: float) -> csc_matrix:
        """(6 N, 6 N) of the internal forces, by differences of the elements' own."""
        stiffness, late = self._lagging(before, step)
        columns = []
        for side in (0, 1):
            for c in range(6):
                both = []
                for change in (NUDGE, -NUDGE):
                    place, rotation = state.place[self.net.element], state.rotation[self.net.element]
                    step_of = change * np.eye(3)[c % 3]
                    if c < 3:
                        place[:, side] += step_of
                    else:
                        rotation[:, side] = rotation[:, side] @ matrix_from_rotation_vector(step_of)
                    both.append(self._forces(place, rotation, stiffness, late))
                columns.append((both[0] - both[1]).reshape(-1, 12) / (2.0 * NUDGE))
        return summed_blocks(np.stack(columns, axis=2), self._entry, 6 * len(self.mass))

    # ---- forces -------------------------------------------------------------------------------
    def _lagging(self, before: RodState, step: float) -> tuple[np.ndarray, np.ndarray | None]:
        """Stiffness with what viscosity adds in a step, and the strain that it is counted from."""
        if "viscosity" not in self.effects:
            return self.stiffness, None
        share = self.lag / step
        own = before.place[self.net.element], before.rotation[self.net.element]
        strain = strains(*own, self.net.frame, self._rest, self.net.length)
        return self.stiffness * (1.0 + share), share / (1.0 + share) * strain

    def _forces(
        self, place: np.ndarray, rotation: np.ndarray, stiffness: np.ndarray, late: np.ndarray | None
    ) -> np.ndarray:
        """(E, 2, 6) of the elements' nodes, places (E, 2, 3) [m], rotations (E, 2, 3, 3)."""
        return nodal_forces(place, rotation, self.net.frame, self._rest, self.net.length, stiffness, late)

    def _outside(self, x: np.ndarray, v: np.ndarray, time: float, step: float) -> np.ndarray:
        """(N, 3) [N] of weight, effects, causes and loads on the nodes."""
        force = self.mass[:, None] * body_field(self.gravity, v, time, self.effects)
        force = force + drag(v, self.surface, self.effects)
        if "tether" in self.effects:
            at = self._spots["tether"]
            node, weight = self.net.element[at.element[0]], np.array([[1.0 - at.share[0]], [at.share[0]]])
            force[node] += weight * tether((weight * x[node]).sum(0, keepdims=True), self.effects["tether"])
        for thing, where in self._causes:
            state = MaterialState(
                self.net.nodes, x, v, np.tile(np.eye(3), (len(x), 1, 1)), self.mass, self.volume, where, time
            )
            force = force + CAUSES[thing.name].function(state, thing.values)[0]
        for pull, begin, end in self._loads:
            # Of the step in which it starts or ends, by its middle.
            if begin <= time - 0.5 * step < end:
                force = force + pull
        return force
