"""The stress-free shape of an object published in equilibrium, with derivatives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mphygs import _core
from mphygs.model.belief import Belief, Parameter
from mphygs.model.registry import effect
from mphygs.simulate.body import Body
from mphygs.simulate.errors import SimulationError
from mphygs.simulate.fields import (
    at_rest,
    core_effects,
    core_input_tangent,
    core_inputs,
    places,
)

# Shares of the load on the way to it, where Newton's method does not get there at once: few, then many.
LOAD_STAGES = ((0.35, 0.7, 1.0), tuple(np.arange(1, 13) / 12.0))


def _acting(belief: Belief) -> tuple[Belief, tuple[str, ...]]:
    """What of a belief acts at rest, and the core effects of it."""
    rest = at_rest(belief)
    known = {n: effect(n) for n in core_effects(rest)}
    active = tuple(
        n
        for n, spec in known.items()
        if spec.loads_at_rest or spec.site == "volume" and not spec.carries_gravity
    )
    terms = tuple(t for t in rest.terms if t.name in active or effect(t.name).site == "material")
    return replace(rest, terms=terms), active


def _load(model: object, fields: dict[str, np.ndarray]) -> np.ndarray:
    """External force on the nodes at rest, (N, 3) [N]."""
    return model.node_mass(fields)[:, None] * fields["gravity"] + model.rest_forces(fields)


class RestShape:
    """Solves for the stress-free state of one body and keeps the last solution.

    Not to be shared between threads: each solution replaces the factorisation.
    """

    def __init__(self, body: Body) -> None:
        self._body = body
        self._key: object = None
        self._solver: object = None
        self._model: object = None
        self._solution: dict | None = None
        self._coordinates: bytes | None = None
        self._unsolved_models: dict = {}

    def answers(self, belief: Belief, parameter: Parameter) -> bool:
        """Whether the stress-free shape may change with a parameter of a belief: not with a wall, say."""
        owner = parameter.key.rsplit(".", 1)[0]
        return owner in self._body.part_names or owner in _acting(belief)[0].effects

    def _prepare(self, belief: Belief) -> Belief:
        """The solver made ready. Returns what of the belief acts at rest; all else, a wall say, asks for
        no other solution."""
        rest, active = _acting(belief)
        spots = places(rest)
        key = (active, rest.law, spots.tobytes())
        if key != self._key:
            self._model = self._model_of(active, rest.law, spots)
            self._solver = _core.Equilibrium(self._model)
            self._key = key
            self._coordinates = None
        return rest

    def _model_of(self, active: tuple[str, ...], law: str, spots: np.ndarray) -> object:
        geometry = dict(self._body.geometry)
        if len(spots):
            geometry |= {"places": spots, "place_cell": self._body.nearest_cell(spots)}
        return _core.TotalLagrangianFloat64(geometry, {"active": list(active), "law": law})

    def solve(self, belief: Belief) -> dict[str, np.ndarray]:
        """deformation0 (B, 9, 8) and volume_ratio (B, 8) of the stress-free state.

        Raises SimulationError where the object cannot carry its weight in the published shape.
        """
        rest = self._prepare(belief)
        fields = core_inputs(rest, self._body)
        load = _load(self._model, fields)
        # At a growing strain the rest state is that of time zero: nothing has grown yet.
        signature = np.concatenate(
            [fields["mu"].ravel(), fields["lambda"].ravel(), load.ravel(), fields["effect"]]
        ).tobytes()
        if signature != self._coordinates:
            # Always from no load: a start from another solution saves one step of four, but a soft object
            # has several equilibria, and which one is found must not depend on what was asked before.
            try:
                self._solution = self._newton(fields, load, np.zeros(0))
            except SimulationError:
                self._solution = self._ramped(fields, load)
            self._coordinates = signature
        return self._solution

    def _newton(
        self, fields: dict[str, np.ndarray], load: np.ndarray, start: np.ndarray
    ) -> dict[str, np.ndarray]:
        return self._solver.solve(fields, self._body.quadrature.volumes, load, start)

    def _ramped(self, fields: dict[str, np.ndarray], load: np.ndarray) -> dict[str, np.ndarray]:
        """From no load to the whole of it in stages, for shapes that sag far. Raises SimulationError."""
        for stages in LOAD_STAGES:
            start = np.zeros(0)
            try:
                for share in stages:
                    solution = self._newton(fields, share * load, start)
                    start = solution["map"]
            except SimulationError as error:
                failure = error
                continue
            return solution
        raise failure

    def tangent(
        self, belief: Belief, parameters: Sequence[Parameter], *, beside: Belief | None = None
    ) -> list[dict[str, np.ndarray]]:
        """Derivatives of deformation0 and volume_ratio by the coordinates of parameters.

        beside: the belief without effects that this one has at their null; where this one `rests_as` that,
        one solution serves all such beliefs.
        """
        if beside is not None and not self.rests_as(belief, beside):
            beside = None
        solved = self._solution_of(beside or belief)
        rest, active = _acting(belief)
        fields = core_inputs(rest, self._body)
        model = self._model if beside is None else self._unsolved(rest, active)
        load = _load(model, fields)
        zero = np.zeros((load.shape[0], 3))
        directions = []
        for parameter in parameters:
            if not self.answers(belief, parameter):
                directions.append(({}, zero))
                continue
            try:
                change = core_input_tangent(rest, self._body, parameter)
            except KeyError:
                directions.append(({}, zero))
                continue
            # The load is linear in masses and strengths: one difference is its derivative.
            step = 1e-3
            moved = {k: v + step * change[k] if k in change else v for k, v in fields.items()}
            slope = (_load(model, moved) - load) / step
            inner = {k: change[k] for k in ("mu", "lambda", "effect") if k in change}
            directions.append((inner, slope))
        return solved.tangent(directions)

    def _solution_of(self, belief: Belief) -> object:
        """The solver at a belief's solution."""
        self.solve(belief)
        self._prepare(belief)
        return self._solver

    def rests_as(self, belief: Belief, beside: Belief) -> bool:
        """Whether a belief with effects at their null besides another one's rests as that one does, whose
        solution then tells all of its derivatives: what it has more of acts from outside, or is a material's
        change from place to place."""
        more = set(_acting(belief)[0].effects) - set(_acting(beside)[0].effects)
        added = [effect(name) for name in more]
        return all(spec.loads_at_rest or spec.site == "material" and not spec.replaces for spec in added)

    def _unsolved(self, rest: Belief, active: tuple[str, ...]) -> object:
        """A model that tells loads, of what acts at rest."""
        spots = places(rest)
        key = (active, rest.law, spots.tobytes())
        if key not in self._unsolved_models:
            self._unsolved_models[key] = self._model_of(active, rest.law, spots)
        return self._unsolved_models[key]

    def adjoint(self, deformation0_bar: np.ndarray, volume_ratio_bar: np.ndarray) -> tuple[dict, np.ndarray]:
        """Bars of (mu, lambda, effect) and of the node load for bars of the last solution."""
        return self._solver.adjoint(deformation0_bar, volume_ratio_bar)
