"""The total-Lagrangian transfer behind a prediction: nodes carry the markers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np
from scipy.sparse import bsr_matrix, csr_matrix

from mphygs.capture.actuators import Force
from mphygs.capture.holds import Load
from mphygs.model.belief import Belief, Parameter
from mphygs.model.registry import USUAL_LAW
from mphygs.simulate import core_runs
from mphygs.simulate.body import Attachment, Body, core_model, with_places
from mphygs.simulate.core_runs import Apart, Arrays, Progress
from mphygs.simulate.marker_carriers import Carriers
from mphygs.simulate.observer import Observer
from mphygs.simulate.pull_distribution import on_nodes
from mphygs.simulate.transfer import Carried, Loss, Start, Transfer

_NOWHERE = np.zeros((0, 3))

# Of an implicit step: iterations, and new matrices. A body that bends far takes more of both than a thick
# one; these two hold all bodies of benchmarks/implicit within a factor of 2.5.
ITERATIONS, RENEWALS = 12.0, 0.25
# Forces of a block of eight points in single precision, as an explicit substep takes them, in the operations
# that the core counts with: half of those in double precision.
FORCES = 1e4


class TotalLagrangian(Transfer):
    """State on the nodes of a grid that is fixed to the rest shape."""

    batch = 16
    keeps_apart = True

    @property
    def grid_body(self) -> Body:
        return self.body

    def _new_model(self, active: tuple[str, ...], spots: np.ndarray, law: str, number: type) -> object:
        body = with_places(self.body, spots)
        return core_model(
            replace(body, geometry=body.geometry | self._actuation) if self._actuation else body,
            active=active,
            dtype=number,
            law=law,
            threads=1,
            memory_budget=self.settings.memory_budget,
        )

    def _plain(self) -> object:
        """A model that knows the nodes and their weights."""
        return self.model((), _NOWHERE, USUAL_LAW)

    @cached_property
    def implicit_cost(self) -> float:
        iteration, renewal = self._plain().implicit_cost()
        forces = FORCES * len(self.body.quadrature.points)
        return (ITERATIONS * iteration + RENEWALS * renewal) / forces

    def largest_rates(self, model: object, fields: Arrays, hook: object | None) -> tuple[float, float]:
        return tuple(model.largest_rates(fields, hook=hook))

    def carriers(self, attachment: Attachment) -> Carriers:
        free = attachment.hold < 0
        weights = self._plain().weights(attachment.anchor[free], attachment.cell[free])
        return Carriers.of(attachment, free, weights)

    def places_at_rest(self) -> np.ndarray:
        return self._plain().node_positions

    def spread(
        self, rows: csr_matrix, markers: np.ndarray
    ) -> tuple[csr_matrix | bsr_matrix, np.ndarray | None]:
        return on_nodes(self._plain(), self.body, rows, markers, self.settings.spacing), None

    def point_rows(self, points: np.ndarray, part: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        node, value, _ = self._plain().weights(points, self.body.nearest_cell(points, part))
        return node, value

    def load_share(self, load: Load | Force) -> np.ndarray:
        q, model = self.body.quadrature, self._plain()
        inside, share = self.body.inside(load.box)
        node, value, _ = model.weights(q.points.reshape(-1, 3)[inside], self.body.point_cell[inside])
        per_node = np.zeros(model.node_count)
        np.add.at(per_node, node.ravel(), (value * share[:, None]).ravel())
        return per_node

    def point_share(self, place: np.ndarray) -> np.ndarray:
        model = self._plain()
        node, value, _ = model.weights(place[None], self.body.nearest_cell(place[None]))
        per_node = np.zeros(model.node_count)
        np.add.at(per_node, node.ravel(), value.ravel())
        return per_node

    def prestressed(self, belief: Belief) -> dict[str, np.ndarray]:
        solution = self.rest_shape.solve(belief)
        volumes = self.body.quadrature.volumes
        return {
            "deformation0": solution["deformation0"],
            "stress_volume": volumes * solution["volume_ratio"].reshape(-1, 8),
        }

    def prestress_slopes(
        self, owner: Belief, parameters: Sequence[Parameter], beside: Belief
    ) -> list[dict[str, np.ndarray]]:
        volumes = self.body.quadrature.volumes
        return [
            {
                "deformation0": slope["deformation0"],
                "stress_volume": volumes * slope["volume_ratio"].reshape(-1, 8),
            }
            for slope in self.rest_shape.tangent(owner, parameters, beside=beside)
        ]

    def admissible(self, start: Start, carried: Carried) -> Start:
        """By the least change of the nodes that puts the trace on every held face where its hold is and
        closes the joints between parts."""
        g = self.body.geometry
        if not len(g["row_hold"]):
            return start
        grid = self._plain().node_index
        number = {tuple(index): k for k, index in enumerate(grid)}
        rows = np.zeros((len(g["row_hold"]), len(grid)))
        owner = np.repeat(np.arange(len(rows)), np.diff(g["row_begin"]))
        for row, index, weight in zip(owner, g["row_node"], g["row_weight"], strict=True):
            rows[row, number[tuple(index)]] += weight
        wanted, speed = np.zeros((2, len(rows), 3))
        for h in range(g["hold_count"]):
            mine = g["row_hold"] == h
            target = g["row_target"][mine]
            now, speed[mine] = carried(h, target)
            wanted[mine] = now - target
        used = np.flatnonzero(rows.any(0))
        solve = np.linalg.pinv(rows[:, used])
        displacement, velocity = start.displacement.copy(), start.velocity.copy()
        displacement[used] += solve @ (wanted - rows @ displacement)
        velocity[used] += solve @ (speed - rows @ velocity)
        return replace(start, displacement=displacement, velocity=velocity)

    def from_grid(self, field: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return field, np.zeros((*field.shape, 3))

    def begun(self, fields: dict[str, np.ndarray], start: Start) -> dict[str, np.ndarray]:
        return fields | {"displacement0": start.displacement, "velocity0": start.velocity}

    def begun_change(self, change: dict[str, np.ndarray], start: Start) -> dict[str, np.ndarray]:
        return change

    def begun_slope(self, fields: dict[str, np.ndarray], slope: Start) -> dict[str, np.ndarray]:
        return self.begun({}, slope)

    def simulate(
        self,
        model: object,
        fields: Arrays,
        schedule: dict,
        progress: Progress,
        hook: object | None,
        observer: Observer | None = None,
    ) -> tuple[np.ndarray, ...]:
        return core_runs.run_core(model, fields, schedule, progress, hook, observer)

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
        return core_runs.run_core_tangent(
            model, fields, directions, schedule, progress, hook, apart, observer
        )

    def gradient(
        self, model: object, fields: Arrays, schedule: dict, loss: Loss, hook: object | None
    ) -> dict[str, np.ndarray]:
        return core_runs.run_core_gradient(model, fields, schedule, lambda *states: loss(states), hook)

    def deformation(self, states: tuple, belief: Belief) -> np.ndarray:
        q = self.body.quadrature
        node, _, gradient = self._plain().weights(q.points.reshape(-1, 3), self.body.point_cell)
        start = np.broadcast_to(np.eye(3), (len(node), 3, 3))
        if belief.prestress == "equilibrium":
            start = self.prestressed(belief)["deformation0"].reshape(-1, 3, 3, 8)
            start = np.moveaxis(start, -1, 1).reshape(-1, 3, 3)
        out = [
            (np.eye(3) + np.einsum("pkc,pkj->pcj", u[node], gradient)) @ start
            for u in np.asarray(states[0], float)
        ]
        return np.array(out).reshape(len(out), -1, 8, 3, 3)
