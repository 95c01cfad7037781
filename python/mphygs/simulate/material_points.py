"""The MLS-MPM transfer behind a prediction: particles carry the markers."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np
from scipy.sparse import bsr_matrix, csr_matrix
from scipy.spatial import cKDTree

from mphygs import _core
from mphygs.capture.actuators import Force
from mphygs.capture.holds import Load
from mphygs.model.belief import Belief, Parameter
from mphygs.simulate import core_runs
from mphygs.simulate.body import LANES, Attachment, Body
from mphygs.simulate.core_runs import Apart, Arrays, Progress
from mphygs.simulate.marker_carriers import Carriers
from mphygs.simulate.observer import Observer
from mphygs.simulate.particle_body import ParticleBody
from mphygs.simulate.pull_distribution import on_particles
from mphygs.simulate.transfer import Loss, Start, Transfer

# Particles that carry one marker together: about those within 0.85 of a spacing.
NEIGHBOURS = 20
# The clamp gives way, and brakes, in proportion to relaxation * substep / weight. With these it does neither
# to speak of; with 10 and 100 the modulus that a bar seems to have changed by 7 to 10 % with half the
# substep, and its swing lost energy twice as fast.
HOLD_RELAXATION, HOLD_WEIGHT = 1.0, 1000.0


class MaterialPoints(Transfer):
    """State on particles, which hand it to a grid and take it back in every substep."""

    batch = 4
    body: ParticleBody

    @property
    def grid_body(self) -> Body:
        return self.body.grid

    def _new_model(self, active: tuple[str, ...], spots: np.ndarray, law: str, number: type) -> object:
        kind = _core.MlsMpmFloat32 if number == np.float32 else _core.MlsMpmFloat64
        points = self.body.geometry["points"]
        extent = float(np.linalg.norm(np.ptp(points, axis=0)))
        geometry = self.body.geometry | self._actuation
        if len(spots):
            geometry |= {"places": spots, "place_particle": self.body.nearest_free(spots).astype(np.int32)}
        settings = {
            "active": list(active),
            "law": law,
            "threads": 1,
            "memory_budget": self.settings.memory_budget,
            "displacement_limit": 100.0 * extent + 100.0,
            "hold_relaxation": HOLD_RELAXATION,
            "hold_weight": HOLD_WEIGHT,
        }
        return kind(geometry, settings)

    def largest_rates(self, model: object, fields: Arrays, hook: object | None) -> tuple[float, float]:
        if hook is not None:
            raise ValueError(core_runs.NO_HOOK)
        return tuple(model.largest_rates(fields))

    def carriers(self, attachment: Attachment) -> Carriers:
        free = attachment.hold < 0
        return Carriers.of(attachment, free, self._weights(attachment.anchor[free], attachment.part[free]))

    def _weights(self, at: np.ndarray, part: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Weights of particles at points (M, 3) of given parts, see `moving_least_squares`.

        A part's own particles carry its markers, held ones too: the grid may bind it to another part.
        """
        points, own = self.body.geometry["points"], self.body.geometry["part"]
        count = min(NEIGHBOURS, len(points))
        index = np.zeros((len(at), count), np.int64)
        for number in np.unique(part):
            mine, among = part == number, np.flatnonzero(own == number)
            if len(among) < count:
                among = np.arange(len(points))
            near = cKDTree(points[among]).query(at[mine], k=np.arange(1, count + 1))[1]
            index[mine] = among[near]
        return index, *moving_least_squares(points[index], at)

    def places_at_rest(self) -> np.ndarray:
        return self.body.geometry["points"]

    def spread(
        self, rows: csr_matrix, markers: np.ndarray
    ) -> tuple[csr_matrix | bsr_matrix, np.ndarray | None]:
        points, volumes = self.body.geometry["points"], self.body.quadrature.volumes.ravel()
        node, value, _ = self._on_grid
        begin = np.arange(0, node.size + 1, node.shape[1])
        shape = (len(points), self._grid_model.node_count)
        weights = csr_matrix((value.ravel(), node.ravel(), begin), shape=shape)
        particles = (points, volumes, LANES * self.body.free_block_count)
        return on_particles(
            self._grid_model, self.grid_body, weights, rows, markers, particles, self.settings.spacing
        )

    def point_rows(self, points: np.ndarray, part: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        index, value, _ = self._weights(points, part)
        return index, value

    def load_share(self, load: Load | Force) -> np.ndarray:
        inside, share = self.body.inside(load.box)
        out = np.zeros(len(inside))
        out[inside] = share
        return out

    def point_share(self, place: np.ndarray) -> np.ndarray:
        out = np.zeros(len(self.places_at_rest()))
        out[self.body.nearest_free(place[None])] = 1.0
        return out

    @cached_property
    def _source(self) -> np.ndarray:
        """(N,) free particle whose rest state each particle has.

        Held ones take it from the nearest free one: the stress goes on behind the face of the clamp. Without
        stress there the grid nodes that both share would be pushed out of balance.
        """
        points, free = self.body.geometry["points"], LANES * self.body.free_block_count
        return np.concatenate([np.arange(free), self.body.nearest_free(points[free:])])

    def _from_grid(self, solution: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Deformation (N, 3, 3) and volume (B, 8) [m^3] of the particles in a rest state of the grid."""
        f = solution["deformation0"].reshape(-1, 3, 3, LANES)
        deformation = np.moveaxis(f, -1, 1).reshape(-1, 3, 3)[self._source]
        volumes = self.body.quadrature.volumes
        ratio = solution["volume_ratio"].ravel()[self._source].reshape(volumes.shape)
        return {"deformation0": deformation, "stress_volume": volumes * ratio}

    def prestressed(self, belief: Belief) -> dict[str, np.ndarray]:
        return self._from_grid(self.rest_shape.solve(belief))

    def prestress_slopes(
        self, owner: Belief, parameters: Sequence[Parameter], beside: Belief
    ) -> list[dict[str, np.ndarray]]:
        return [self._from_grid(slope) for slope in self.rest_shape.tangent(owner, parameters, beside=beside)]

    def from_grid(self, field: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        node, value, gradient = self._on_grid
        near = field[node]
        return np.einsum("pn,pnc->pc", value, near), np.einsum("pnj,pnc->pcj", gradient, near)

    @cached_property
    def _on_grid(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Nodes of the grid that each particle is between, their weights and those of the gradient."""
        grid, geometry = self.grid_body, self.body.geometry
        cells = grid.nearest_cell(geometry["points"], geometry["part"])
        return self._grid_model.weights(geometry["points"], cells)

    @cached_property
    def _grid_model(self) -> object:
        """A model that knows the nodes of the grid and their weights."""
        return _core.TotalLagrangianFloat64(self.grid_body.geometry, {"active": [], "law": "neo-hookean"})

    def begun(self, fields: dict[str, np.ndarray], start: Start) -> dict[str, np.ndarray]:
        deformation = start.gradient + np.eye(3)
        if "deformation0" in fields:
            deformation = deformation @ fields["deformation0"]
        return fields | {
            "displacement0": start.displacement,
            "velocity0": start.velocity,
            "deformation0": deformation,
        }

    def begun_change(self, change: dict[str, np.ndarray], start: Start) -> dict[str, np.ndarray]:
        if "deformation0" not in change:
            return change
        return change | {"deformation0": (start.gradient + np.eye(3)) @ change["deformation0"]}

    def begun_slope(self, fields: dict[str, np.ndarray], slope: Start) -> dict[str, np.ndarray]:
        return {
            "displacement0": slope.displacement,
            "velocity0": slope.velocity,
            "deformation0": slope.gradient @ fields.get("deformation0", np.eye(3)),
        }

    def simulate(
        self,
        model: object,
        fields: Arrays,
        schedule: dict,
        progress: Progress,
        hook: object | None,
        observer: Observer | None = None,
    ) -> tuple[np.ndarray, ...]:
        return self._displaced(core_runs.run_core(model, fields, schedule, progress, hook, observer))

    def _displaced(self, trajectory: tuple[np.ndarray, ...]) -> tuple[np.ndarray, ...]:
        position, *others = trajectory
        return position - self.body.geometry["points"], *others

    def tangent(
        self,
        model: object,
        fields: Arrays,
        directions: Sequence[Arrays],
        schedule: dict,
        progress: Progress,
        hook: object | None,
        apart: Sequence[Apart | None] = (),
        observer: Observer | None = None,
    ) -> list[tuple[np.ndarray, ...]]:
        value, *slopes = core_runs.run_core_tangent(
            model, fields, directions, schedule, progress, hook, observer=observer
        )
        return [self._displaced(value), *slopes]

    def gradient(
        self, model: object, fields: Arrays, schedule: dict, loss: Loss, hook: object | None
    ) -> dict[str, np.ndarray]:
        def bars(*trajectory: np.ndarray) -> tuple[np.ndarray | None, ...]:
            displacement, velocity, *reaction = loss(self._displaced(trajectory))
            return displacement, velocity, None, *reaction

        return core_runs.run_core_gradient(model, fields, schedule, bars, hook)

    def deformation(self, states: tuple, belief: Belief) -> np.ndarray:
        free = LANES * self.body.free_block_count
        return np.asarray(states[2], float)[:, :free].reshape(len(states[2]), -1, LANES, 3, 3)


def moving_least_squares(points: np.ndarray, at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Weights that give a field and its gradient at a point from its values at points around it.

    points: (M, K, 3) [m], the neighbours of each of at: (M, 3) [m] -> value (M, K), gradient (M, K, 3) [1/m].
    Exact for linear fields: the value and slope of the plane that fits best, nearer points counting
    more (Lancaster and Salkauskas, "Surfaces generated by moving least squares methods", 1981). Where all
    points lie in one plane the slope across it is zero.
    """
    apart = points - at[:, None]
    distance = np.linalg.norm(apart, axis=2)
    reach = 1.05 * distance.max(axis=1, initial=0.0, keepdims=True)
    weight = (1.0 - (distance / reach) ** 2) ** 2
    basis = np.concatenate([np.ones((*distance.shape, 1)), apart / reach[..., None]], axis=2)
    moments = np.einsum("mk,mka,mkb->mab", weight, basis, basis)
    shape = np.einsum("mab,mkb,mk->mka", np.linalg.pinv(moments, rcond=1e-10, hermitian=True), basis, weight)
    return shape[..., 0], shape[..., 1:] / reach[..., None]
