"""An object and what is believed of it, ready to be simulated."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from mphygs.api.calls import CaptureLike, RunLike, folder_of
from mphygs.api.interface_errors import InputError, as_interface_errors
from mphygs.capture.checks import check_object
from mphygs.capture.format import Capture, Markers, Sequence
from mphygs.capture.format import load_capture as read_capture
from mphygs.fit.of_run import experiment_of
from mphygs.fit.placement import with_placed_effect
from mphygs.fit.run import load_run
from mphygs.fit.spacings import check_spacing, default_spacing
from mphygs.fit.start import starting_belief
from mphygs.model.belief import Belief
from mphygs.model.registry import USUAL_LAW, effect
from mphygs.simulate.body import Body
from mphygs.simulate.prediction import Predictor
from mphygs.simulate.settings import Settings


@dataclass(frozen=True, eq=False)
class Model:
    """capture: object, gravity and motions; belief: materials and effects; settings: of the simulation.

    Models are never changed: `with_parameters` and `with_effect` return another one, which shares the grids
    that were built already.
    """

    capture: Capture
    belief: Belief
    settings: Settings
    _bodies: dict[bytes, Body] = field(default_factory=dict, repr=False)

    @classmethod
    def of(
        cls,
        capture: CaptureLike,
        *,
        law: str = USUAL_LAW,
        prestress: Literal["off", "paper", "equilibrium"] | None = None,
        transfer: Literal["total-lagrangian", "mls"] = "total-lagrangian",
        spacing: float | None = None,
        dtype: Literal["float32", "float64"] = "float32",
        workers: int | None = None,
    ) -> Model:
        """The model that a fit starts from: what the capture knows, and usual values for the rest.

        spacing: of the grid [m], by default that of `fit`; dtype: of the simulation. Raises InputError.
        """
        with as_interface_errors():
            if isinstance(capture, Capture):
                check_object(capture)  # as what is read from a folder was
                own = capture
            else:
                own = read_capture(capture)
            belief = starting_belief(own, prestress=prestress, law=law)
            width = default_spacing(own) if spacing is None else spacing
            check_spacing(own, width, "spacing")
            settings = Settings(width, transfer=transfer, dtype=dtype)
            return cls(own, belief, settings if workers is None else replace(settings, workers=workers))

    @classmethod
    def of_run(cls, run: RunLike) -> Model:
        """The fitted model of a run. Raises InputError."""
        with as_interface_errors():
            experiment, belief = experiment_of(load_run(folder_of(run)))
            return cls(experiment.capture, belief, experiment.settings)

    @property
    def parameters(self) -> dict[str, float]:
        """All numbers by key, "<part>.youngs_modulus" [Pa] or "<effect>.<parameter>"."""
        return {p.key: p.value for p in self.belief.parameters}

    @property
    def units(self) -> dict[str, str]:
        """The unit of every number."""
        return {p.key: p.unit for p in self.belief.parameters}

    @property
    def effects(self) -> tuple[str, ...]:
        """Names of the effects in it."""
        return self.belief.effects

    def with_parameters(self, values: Mapping[str, float]) -> Model:
        """This model with some numbers changed. Raises InputError for an unknown key or a value out of its
        bounds."""
        belief = self.belief
        for key, value in values.items():
            if key not in belief:
                known = ", ".join(self.parameters)
                raise InputError(f"parameter '{key}' is not in the model; expected one of {known}")
            with as_interface_errors():
                belief = belief.with_parameter(key, value=float(value))
        return replace(self, belief=belief)

    def with_effect(
        self,
        name: str,
        values: Mapping[str, float] | None = None,
        settings: Mapping[str, object] | None = None,
    ) -> Model:
        """This model with an effect added.

        values: of its numbers, the rest stay at their null; settings: "place" (3,) [m], "part" or "axis" (3,)
        for effects that need them, by default as `fit` chooses them. Raises InputError.
        """
        with as_interface_errors():
            try:
                spec = effect(name)
            except KeyError as error:
                raise InputError(str(error.args[0])) from error
            known = [p.name for p in spec.parameters]
            for key in values or {}:
                if key not in known:
                    raise InputError(f"effect '{name}' has no number '{key}'; expected {', '.join(known)}")
            if settings is None and spec.settings:
                seen = [s.name for s in self.capture.sequences if s.markers is not None]
                if not seen:
                    wanted = ", ".join(spec.settings)
                    raise InputError(f"effect '{name}' has no {wanted}; expected settings that say so")
                model = replace(self, belief=with_placed_effect(self.belief, name, self.capture, seen))
                return model.with_parameters({f"{name}.{k}": v for k, v in (values or {}).items()})
            return replace(self, belief=self.belief.with_effect(name, values, settings))

    def recording(
        self, sequence: str | Sequence | None = None, points: np.ndarray | None = None
    ) -> Sequence:
        """A motion of the model, by default its first one, followed at `points`, (M, 3) [m] at rest, or at
        its markers. Raises InputError."""
        if isinstance(sequence, Sequence):
            found = sequence
        else:
            name = self.capture.sequences[0].name if sequence is None else sequence
            try:
                found = self.capture.sequence(name)
            except KeyError as error:
                raise InputError(str(error.args[0])) from error
        if points is None:
            if found.markers is None:
                raise InputError(
                    f"sequence '{found.name}' has no markers; expected points to follow, (M, 3) [m]"
                )
            return found
        at = np.asarray(points, dtype=np.float64)
        if at.ndim != 2 or at.shape[1] != 3 or not len(at) or not np.isfinite(at).all():
            raise InputError(f"points of shape {at.shape}: expected (M, 3) finite places at rest [m]")
        return replace(found, markers=Markers(np.full((found.frames, len(at), 3), np.nan), at, 1.0))

    def predictor(self, recording: Sequence) -> Predictor:
        """What simulates a motion; grids are built once for the same holds."""
        held = b"".join(np.asarray(hold.box, float).tobytes() for hold in recording.held)
        found = Predictor(self.capture, recording, self.settings, body=self._bodies.get(held))
        self._bodies.setdefault(held, found.body)
        return found
