"""What a prediction asks of a transfer: models, fields of its own, runs, and what carries the markers."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import bsr_matrix, csr_matrix

from mphygs.capture.actuators import Force
from mphygs.capture.holds import Load
from mphygs.model.belief import Belief, Parameter
from mphygs.simulate.body import Attachment, Body
from mphygs.simulate.core_runs import Apart, Arrays, Progress
from mphygs.simulate.marker_carriers import Carriers
from mphygs.simulate.observer import Observer
from mphygs.simulate.prestress import RestShape
from mphygs.simulate.settings import Settings

# Places (K, 3) [m] and velocities [m/s] of points (K, 3) that hold number h carries.
Carried = Callable[[int, np.ndarray], tuple[np.ndarray, np.ndarray]]

# Of the states that `simulate` gives, the bars: of the carriers' displacement and velocity, (S, N, 3), and,
# where the schedule asks for them, of the reactions, (S, H, 6).
Loss = Callable[[tuple], tuple[np.ndarray | None, ...]]


@dataclass(frozen=True, eq=False)
class Start:
    """The state of the carriers at a frame in mid-motion. displacement: (N, 3) [m]; velocity: (N, 3) [m/s];
    gradient: (N, 3, 3), of the displacement by the place at rest."""

    frame: int
    displacement: np.ndarray
    velocity: np.ndarray
    gradient: np.ndarray


class Transfer(ABC):
    """One object under one set of holds, discretised for one of the core's transfers.

    batch: directions that the core carries at once in one run; keeps_apart: whether one of them may have
    effects of the volume, the surface and the body that the run has not. Its carriers are what the core's
    trajectory is given at: N nodes or particles.
    """

    batch: int
    keeps_apart = False

    def __init__(self, body: Body, settings: Settings) -> None:
        self.body, self.settings = body, settings
        self._models: dict = {}
        self._actuation: dict[str, object] = {}
        self.forget()

    def share(self, model: object, threads: int) -> None:
        """Let so many threads share the work of the model's next runs; not while one is under way."""
        model.threads = threads

    def actuate(self, actuation: dict[str, object]) -> None:
        """Let the models from now on have loads that follow the object, as the core takes them."""
        self._actuation = {"actuation": actuation}
        self._models = {}

    def forget(self) -> None:
        """Drop what the rest shape remembers of its last solution."""
        self.rest_shape = RestShape(self.grid_body)

    def model(self, active: Sequence[str], spots: np.ndarray, law: str, *, implicit: bool = False) -> object:
        """The compiled model with core effects `active` and effects at `spots` (K, 3) [m], kept; for implicit
        steps one of the precision that they need."""
        number = np.float64 if implicit else self.settings.number
        key = (tuple(sorted(set(active))), spots.tobytes(), law, number)
        if key not in self._models:
            self._models[key] = self._new_model(key[0], spots, law, number)
        return self._models[key]

    @property
    @abstractmethod
    def grid_body(self) -> Body:
        """The total-Lagrangian discretisation, on which rest shapes are solved for."""

    @abstractmethod
    def _new_model(self, active: tuple[str, ...], spots: np.ndarray, law: str, number: type) -> object: ...

    @property
    def implicit_cost(self) -> float:
        """How many explicit substeps cost as much as an implicit step; no number where there is none."""
        return np.inf

    @abstractmethod
    def largest_rates(self, model: object, fields: Arrays, hook: object | None) -> tuple[float, float]:
        """Largest squared frequency [1/s^2] and damping rate [1/s] of the model linearised at rest."""

    @abstractmethod
    def carriers(self, attachment: Attachment) -> Carriers:
        """What carries the markers."""

    @abstractmethod
    def places_at_rest(self) -> np.ndarray:
        """(N, 3) of the carriers [m]."""

    @abstractmethod
    def spread(
        self, rows: csr_matrix, markers: np.ndarray
    ) -> tuple[csr_matrix | bsr_matrix, np.ndarray | None]:
        """Accelerations of the carriers, (N, M) or in blocks (3 N, 3 M), for those that markers ask for; and
        (N,) which row of them each carrier has, -1 for none, where several have one.

        rows: (M, N) by which they follow the carriers; markers: (M, 3) at rest [m].
        """

    @abstractmethod
    def load_share(self, load: Load | Force) -> np.ndarray:
        """(N,) share of a known load on every carrier."""

    @abstractmethod
    def point_rows(self, points: np.ndarray, part: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Carriers (M, K) by which material points (M, 3) [m] of parts (M,) go along, and their weights."""

    @abstractmethod
    def point_share(self, place: np.ndarray) -> np.ndarray:
        """(N,) share of every carrier in what sits at a place (3,) [m], a point mass say."""

    @abstractmethod
    def prestressed(self, belief: Belief) -> dict[str, np.ndarray]:
        """deformation0 and stress_volume of the stress-free state, by the belief's equilibrium."""

    @abstractmethod
    def prestress_slopes(
        self, owner: Belief, parameters: Sequence[Parameter], beside: Belief
    ) -> list[dict[str, np.ndarray]]:
        """Derivatives of `prestressed` by the coordinates of a belief's parameters.

        beside: the belief that is simulated, which lacks effects that the owner has at their null."""

    def admissible(self, start: Start, carried: Carried) -> Start:
        """The state nearest to a given one that agrees with the holds. carried: see Carried."""
        return start

    @abstractmethod
    def from_grid(self, field: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """A field (N', 3) on the nodes of `grid_body` as the carriers have it: (N, 3), and its gradient
        (N, 3, 3) by the place at rest, which a transfer without use for it leaves at zero."""

    @abstractmethod
    def begun(self, fields: dict[str, np.ndarray], start: Start) -> dict[str, np.ndarray]:
        """Fields of a run from the rest shape, turned into those of one that begins in mid-motion."""

    @abstractmethod
    def begun_change(self, change: dict[str, np.ndarray], start: Start) -> dict[str, np.ndarray]:
        """The same for a derivative of the fields; the given state does not change."""

    @abstractmethod
    def begun_slope(self, fields: dict[str, np.ndarray], slope: Start) -> dict[str, np.ndarray]:
        """Derivative of the fields, those of a run from the rest shape, by a change of the given state."""

    @abstractmethod
    def simulate(
        self,
        model: object,
        fields: Arrays,
        schedule: dict,
        progress: Progress,
        hook: object | None,
        observer: Observer | None = None,
    ) -> tuple[np.ndarray, ...]:
        """Displacement [m] and velocity [m/s] of the carriers, (S, N, 3), and what else the transfer has.

        Where the schedule asks for them that is the reactions of the holds, (S, H, 6) [N, N m].
        """

    @abstractmethod
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
        """The states of `simulate`, and their derivative in each direction. apart: effects that each alone
        has; where `keeps_apart` is not set there are none."""

    @abstractmethod
    def gradient(
        self, model: object, fields: Arrays, schedule: dict, loss: Loss, hook: object | None
    ) -> dict[str, np.ndarray]:
        """Bars of all fields for those that `loss` says of the states, which it is given once the run is
        through. Raises SimulationError where it is unstable, and what `loss` raises."""

    @abstractmethod
    def deformation(self, states: tuple, belief: Belief) -> np.ndarray:
        """(S, B, 8, 3, 3) deformation from the stress-free state at the free quadrature points."""
