"""One object of finite elements under one hold, and what acts on it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from mphygs.capture.actuators import Force
from mphygs.capture.format import Capture, Load
from mphygs.capture.record import Sequence as Recording
from mphygs.synth.brick_mesh import SAME, brick_mesh
from mphygs.synth.causes import CAUSES, MaterialState
from mphygs.synth.finite_element_drive import Driven
from mphygs.synth.finite_element_rest import stiffness, unloaded
from mphygs.synth.finite_element_stress import MaterialStress, Values, cofactor, published, times, transposed
from mphygs.synth.outside_forces import body_field, drag, tether

if TYPE_CHECKING:
    from mphygs.synth.hidden import Hidden
    from mphygs.synth.recipe import Recipe

# Share of the stable step that is used.
SAFETY = 0.75
OUTSIDE = (
    "gravity", "mass_damping", "air_drag", "wind", "contact", "attached_mass", "tether", "base_motion",
    "compressibility", "stiffness_gradient", "density_gradient",
)  # fmt: skip
KNOWN = (*MaterialStress.KNOWN, *OUTSIDE)


class FiniteElementBody:
    """One object under one hold, and what acts on it."""

    def __init__(
        self, capture: Capture, recording: Recording, recipe: Recipe, hidden: Sequence[Hidden], size: float
    ) -> None:
        self.recording, self.hold = recording, recording.held[0]
        self.mesh = mesh = brick_mesh(capture.parts, self.hold.box, size)
        self.effects = {h.name: h.values for h in hidden if h.kind == "effect"}
        self.terms = {h.name: h for h in hidden if h.kind == "effect"}
        names = tuple(part.name for part in capture.parts)
        materials = [recipe.materials[n] for n in names]
        youngs = np.array([m.youngs_modulus for m in materials])[mesh.part][:, None]
        youngs = youngs * np.exp(self._slope("stiffness_gradient", names, mesh.points))
        ratio = np.array([m.poissons_ratio for m in materials])[mesh.part][:, None] + np.zeros_like(youngs)
        if "compressibility" in self.effects:
            ratio = np.full_like(youngs, self.effects["compressibility"]["nu"])
        mu = youngs / (2.0 * (1.0 + ratio))
        lame = youngs * ratio / ((1.0 + ratio) * (1.0 - 2.0 * ratio))
        self.stress = MaterialStress(mu.ravel(), lame.ravel(), self.effects)
        density = np.array([m.density for m in materials])[mesh.part][:, None]
        at_nodes = density * np.exp(self._slope("density_gradient", names, mesh.nodes[mesh.element]))
        self.mass = mesh.lumped(at_nodes)
        at_points = density * np.exp(self._slope("density_gradient", names, mesh.points))
        self.point_mass = (at_points * mesh.volume).ravel()
        self.held = self.in_hold(mesh.nodes)
        self.gravity = np.asarray(capture.gravity, float)
        # Of each known load the forces on the nodes, and the times between which it acts [s].
        self.loads = [
            (self._spread(load), load.start_frame / recording.fps,
             math.inf if load.end_frame is None else load.end_frame / recording.fps)
            for load in recording.loads
        ]  # fmt: skip
        self.drives = [
            Driven(actuator, mesh, self.hold, names, recording.fps,
                   self._share(actuator.box) if isinstance(actuator, Force) else None)
            for actuator in recording.actuators
        ]  # fmt: skip
        self.causes = [
            (h, np.repeat(mesh.part == names.index(str(h.settings["part"])), 27) if "part" in h.settings
             else np.ones(27 * len(mesh.part), bool))
            for h in hidden if h.kind == "cause"
        ]  # fmt: skip
        self.places = {
            n: mesh.weights(np.array([t.settings["place"]]))
            for n, t in self.terms.items()
            if "place" in t.settings
        }
        self.youngs_modulus = float(youngs.max())
        self.modulus = lame + 2.0 * mu
        self.density = at_points
        # Deformation (3, 3, Q) of the published shape from the stress-free one, None where they are the same.
        self.strained: np.ndarray | None = None
        if capture.rest == "equilibrium":
            self._strain(mu, lame)

    def in_hold(self, points: np.ndarray) -> np.ndarray:
        """(M,) whether points [m] lie in the hold's box."""
        low, high = self.hold.box
        return np.all((points >= low - SAME) & (points <= high + SAME), axis=1)

    def _spread(self, load: Load) -> np.ndarray:
        """(N, 3) [N] of a known load, by the volume about the nodes in its box."""
        return self._share(load.box)[:, None] * load.force

    def _share(self, box: np.ndarray) -> np.ndarray:
        """(N,) of the nodes in a box, by the volume about them."""
        mesh, (low, high) = self.mesh, box
        within = np.all((mesh.nodes >= low - SAME) & (mesh.nodes <= high + SAME), axis=1)
        share = mesh.lumped(np.ones_like(mesh.volume)) * within
        return share / share.sum()

    def _strain(self, mu: np.ndarray, lame: np.ndarray) -> None:
        """The strain in which loads at rest keep the published shape; mu, lame: (E, 27) [Pa]."""
        loads = {n: v for n, v in self.effects.items() if self.terms[n].at_rest}
        still = np.zeros_like(self.mesh.nodes)
        load = self._outside(self.mesh.nodes, still, 0.0, loads)
        if "attached_mass" in loads:
            pull = loads["attached_mass"]["m"] * self.body_field(still[0], 0.0, loads)
            load = load + self.places["attached_mass"].toarray().T * pull
        law = MaterialStress(
            self.stress.mu,
            self.stress.lame,
            {n: v for n, v in self.effects.items() if n in ("fibre", "stiffening")},
        )

        def strained(unloaded_by: np.ndarray) -> np.ndarray:
            back = self._gradient(self._of_elements(unloaded_by))
            for a in range(3):
                back[a, a] += 1.0
            c = cofactor(back)
            return transposed(c) / np.einsum("aq,aq->q", back[0], c[0])

        def inside(unloaded_by: np.ndarray) -> np.ndarray:
            f = strained(unloaded_by)
            return self._nodal(published(law.stress(f, None, 0.0, 0.0), f))

        matrix = stiffness(self.mesh.basis, mu, lame)
        self.strained = strained(unloaded(self.held, matrix, inside, load))

    def _slope(self, name: str, names: tuple[str, ...], points: np.ndarray) -> np.ndarray:
        """slope (X - centroid).axis of a gradient effect in its part, 0 elsewhere; points: (E, n, 3)."""
        if name not in self.effects:
            return np.zeros(points.shape[:2])
        own = self.mesh.part == names.index(str(self.terms[name].settings["part"]))
        axis = np.asarray(self.terms[name].settings["axis"], float)
        volume = self.mesh.volume[own]
        centroid = np.einsum("en,enc->c", volume, self.mesh.points[own]) / volume.sum()
        arm = (points - centroid) @ (axis / np.linalg.norm(axis))
        return self.effects[name]["slope"] * np.where(own[:, None], arm, 0.0)

    def step(self) -> float:
        """A stable step [s]: omega^2 dt^2 + 2 c dt < 4 for the fastest wave and decay in a brick."""
        modulus = self.modulus + 4.0 * self.effects.get("fibre", {}).get("k_f", 0.0)
        modulus = modulus + 0.2 * self.effects.get("stiffening", {}).get("c_2", 0.0)
        modulus *= 1.0 + self.effects.get("relaxation", {}).get("ratio", 0.0)
        curvature = 24.0 * (1.0 / self.mesh.size**2).sum(1)[:, None] / self.density
        stiffness = float((curvature * modulus).max())
        if "contact" in self.effects:
            stiffness += float((self._contact_stiffness() * self.mesh.surface_area / self.mass).max())
        damping = float(curvature.max()) * self.effects.get("viscosity", {}).get("eta", 0.0) * 4.0 / 3.0
        return SAFETY * (-damping + math.sqrt(damping**2 + 4.0 * stiffness)) / stiffness

    def _contact_stiffness(self) -> float:
        """Pressure per depth [Pa/m], as stiff as half a brick."""
        given = self.effects["contact"]["stiffness"]
        return given or 2.0 * self.youngs_modulus / float(self.mesh.size.min())

    def _inside(self, u: np.ndarray, v: np.ndarray, time: float, dt: float) -> np.ndarray:
        """(N, 3) [N] of the material's stress and of causes outside the list."""
        mesh = self.mesh
        moved, speed = self._of_elements(u), self._of_elements(v)
        deformation = self._gradient(moved)
        for a in range(3):
            deformation[a, a] += 1.0
        rate = self._gradient(speed) if "viscosity" in self.effects else None
        if self.strained is not None:
            deformation = times(deformation, self.strained)
            rate = None if rate is None else times(rate, self.strained)
        stress = self.stress.stress(deformation, rate, time, dt)
        body_force = None
        for thing, where in self.causes:
            points = mesh.points.reshape(-1, 3)
            state = MaterialState(
                points,
                points + (moved @ mesh.value.T).reshape(3, -1).T,
                (speed @ mesh.value.T).reshape(3, -1).T,
                deformation.transpose(2, 0, 1),
                self.point_mass,
                mesh.volume.ravel(),
                where,
                time,
            )
            force, more = CAUSES[thing.name].function(state, thing.values)
            if more is not None:
                stress = stress + more.transpose(1, 2, 0)
            if force is not None:
                body_force = force if body_force is None else body_force + force
        if self.strained is not None:
            stress = published(stress, self.strained)
        return self._nodal(stress, body_force)

    def _of_elements(self, values: np.ndarray) -> np.ndarray:
        """(3, E, 27) of nodal values (N, 3)."""
        return np.ascontiguousarray(values[self.mesh.element].transpose(2, 0, 1))

    def _nodal(self, stress: np.ndarray, body_force: np.ndarray | None = None) -> np.ndarray:
        """(N, 3) [N] of a stress (3, 3, Q) [Pa] per area of the published shape, and of forces (Q, 3) [N]."""
        mesh = self.mesh
        weighted = (stress * mesh.volume.ravel()).reshape(3, 3, *mesh.volume.shape) / mesh.size.T[..., None]
        nodal = -weighted.swapaxes(1, 2).reshape(3, -1, 81) @ mesh.slope.reshape(81, 27)
        if body_force is not None:
            nodal += np.ascontiguousarray(body_force.T).reshape(nodal.shape) @ mesh.value
        return mesh.gather @ nodal.reshape(3, -1).T

    def _gradient(self, values: np.ndarray) -> np.ndarray:
        """(3, 3, Q) derivative along x, y, z at the Gauss points of element values (3, E, 27)."""
        slope = (values @ self.mesh.slope.reshape(81, 27).T).reshape(*values.shape[:2], 3, 27).swapaxes(1, 2)
        return (slope / self.mesh.size.T[..., None]).reshape(3, 3, -1)

    def _outside(
        self, x: np.ndarray, v: np.ndarray, time: float, effects: Mapping[str, Values]
    ) -> np.ndarray:
        """(N, 3) [N] of weight and of those `effects` that act on nodes, surface and places."""
        force = self.mass[:, None] * self.body_field(v, time, effects)
        force = force + drag(v, self.mesh.surface_area, effects)
        if "contact" in effects:
            values = effects["contact"]
            normal = np.array([values[f"n_{a}"] for a in "xyz"])
            force = force + self._pressing(x, normal) * normal
        if "tether" in effects:
            at = self.places["tether"]
            force = force + at.T @ tether(at @ x, effects["tether"])
        return force

    def acceleration(
        self, u: np.ndarray, v: np.ndarray, time: float, dt: float, driven: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """(N, 3) [m/s^2], and what the hold exerts on each of its nodes, (H, 3) [N]; driven: (H, 3) of
        these."""
        x = self.mesh.nodes + u
        force = self._inside(u, v, time, dt) + self._outside(x, v, time, self.effects)
        for pull, begin, end in self.loads:
            # Of the step in which it starts or ends, by its middle.
            if begin <= time + 0.5 * dt < end:
                force = force + pull
        for drive in self.drives:
            force = force + drive.force(x, time)
        if "contact" in self.effects:
            force = force + self._friction(x, v, force, dt)
        result = force / self.mass[:, None]
        result[self.held] = driven
        if "attached_mass" in self.effects:
            # A point mass adds m n n^T to the diagonal mass (Sherman-Morrison), and feels every body force;
            # nodes in the hold move as it does, whatever acts on them.
            at, mass = self.places["attached_mass"], self.effects["attached_mass"]["m"]
            n = at.toarray()[0]
            share = np.where(self.held, 0.0, n / self.mass)
            pull = self.body_field(n @ v, time, self.effects) - n @ result
            result += np.outer(share, mass * pull / (1.0 + mass * (n @ share)))
        return result, self.mass[self.held, None] * driven - force[self.held]

    def _pressing(self, x: np.ndarray, normal: np.ndarray) -> np.ndarray:
        """(N, 1) [N] with which the wall presses on every node."""
        depth = np.maximum(self.effects["contact"]["d"] - x @ normal, 0.0)[:, None]
        return self._contact_stiffness() * self.mesh.surface_area[:, None] * depth

    def _friction(self, x: np.ndarray, v: np.ndarray, force: np.ndarray, dt: float) -> np.ndarray:
        """(N, 3) [N] by Coulomb: what would stop the slip of a node within this step, mu times what presses
        on it at most."""
        values = self.effects["contact"]
        normal = np.array([values[f"n_{a}"] for a in "xyz"])
        mass = self.mass[:, None]
        going = v + dt * force / mass
        slip = going - (going @ normal)[:, None] * normal
        speed = np.linalg.norm(slip, axis=1, keepdims=True)
        most = np.minimum(values["mu"] * self._pressing(x, normal), mass * speed / dt)
        return -most * slip / np.where(speed > 0.0, speed, 1.0)

    def body_field(self, v: np.ndarray, time: float, effects: Mapping[str, Values]) -> np.ndarray:
        """Acceleration [m/s^2] by weight and body effects at points of velocity v, (3,) or (N, 3) [m/s]."""
        return body_field(self.gravity, v, time, effects)
