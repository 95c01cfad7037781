"""The true motion of a recipe's object, on a finer grid than a fit's, causes outside the list included."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from mphygs.capture.format import Capture
from mphygs.capture.record import Sequence as Recording
from mphygs.fit.start import starting_belief
from mphygs.model.belief import Belief
from mphygs.simulate.body import Body
from mphygs.simulate.prediction import Predictor
from mphygs.simulate.settings import MLS, Settings
from mphygs.synth.causes import CAUSES, MaterialState
from mphygs.synth.hidden import Hidden
from mphygs.synth.recipe import Recipe
from mphygs.synth.simulated_motion import SimulatedMotion


def true_belief(capture: Capture, recipe: Recipe, hidden: Sequence[Hidden]) -> Belief:
    """The model with the true materials and the hidden effects that the registry names."""
    belief = starting_belief(capture)
    for name, material in recipe.materials.items():
        for quantity in ("youngs_modulus", "density", "poissons_ratio"):
            belief = belief.with_parameter(f"{name}.{quantity}", value=getattr(material, quantity))
    for thing in hidden:
        if thing.kind == "effect":
            belief = belief.with_effect(thing.name, thing.values, thing.settings)
    return replace(belief, known_mass=None)


def simulate_truth(
    capture: Capture,
    recording: Recording,
    recipe: Recipe,
    hidden: Sequence[Hidden],
    spacing: float,
    progress: Callable[[int], bool] | None = None,
) -> SimulatedMotion:
    """True motion of the markers of one recording under what is hidden (faults aside), by the core.

    spacing: of the grid [m]; progress: told the number of frames after release that are done.
    Raises ValueError for what the recipe's transfer cannot have, SimulationError where the motion cannot be
    computed.
    """
    belief = true_belief(capture, recipe, hidden)
    causes = [thing for thing in hidden if thing.kind == "cause"]
    if causes and recipe.simulator == MLS:
        raise ValueError(
            f"'{causes[0].name}': not with the simulator {MLS}, which feels the core's effects only"
        )
    settings = Settings(spacing=spacing, workers=1, transfer=recipe.simulator)
    predictor = CausedPredictor(capture, recording, settings, causes)
    prediction = predictor.predict(belief, progress=progress)
    return SimulatedMotion(
        prediction.position,
        prediction.velocity,
        predictor.attachment.hold < 0,
        prediction.substeps,
        tuple(reading.value for reading in prediction.readings),
    )


class CausedPredictor(Predictor):
    """A predictor whose runs feel causes that no belief can name."""

    def __init__(
        self,
        capture: Capture,
        recording: Recording,
        settings: Settings,
        causes: Sequence[Hidden],
        *,
        body: Body | None = None,
    ) -> None:
        super().__init__(capture, recording, settings, body=body)
        self._causes = tuple(causes)

    def hook(self, belief: Belief, fields: dict) -> object | None:
        """What adds the causes' forces to a run with these fields, None without causes."""
        return self._hook(belief, fields)

    def _hook(
        self,
        belief: Belief,
        fields: dict,
        simulated: Sequence = (),
        changes: Sequence = (),
        number: type | None = None,
    ) -> object | None:
        if not self._causes:
            return super()._hook(belief, fields, simulated, changes, number)
        return CauseForces(self._causes, self.body, fields["mass"])


class CauseForces:
    """The hook of a rollout that adds the forces and stresses of causes, evaluated in every substep.

    mass: (B, 8) [kg] of the body's quadrature points.
    """

    def __init__(self, causes: Sequence[Hidden], body: Body, mass: np.ndarray) -> None:
        self._reference = body.quadrature.points.reshape(-1, 3)
        self._volume, self._mass = body.quadrature.volumes.ravel(), np.asarray(mass, float).ravel()
        part = body.point_part.ravel()
        everywhere = np.ones(len(part), bool)
        self._causes = [
            (
                c,
                part == body.part_names.index(str(c.settings["part"]))
                if "part" in c.settings
                else everywhere,
            )
            for c in causes
        ]

    def forward(
        self,
        first_direction: int,
        time: float,
        position: np.ndarray,
        velocity: np.ndarray,
        deformation: np.ndarray,
    ) -> tuple[np.ndarray | None, np.ndarray | None]:
        """Force (L, Q, 3) [N] and first Piola-Kirchhoff stress (L, Q, 3, 3) [Pa], None where there is none.

        Only the value lane is filled: the further lanes, of derivatives, are asked for when the stable
        substep is sought, and there causes as weak as these do not matter.
        """
        forces: list[np.ndarray | None] = [None, None]
        state = [np.asarray(a[0], float) for a in (position, velocity, deformation)]
        for thing, inside in self._causes:
            material = MaterialState(self._reference, *state, self._mass, self._volume, inside, time)
            for k, more in enumerate(CAUSES[thing.name].function(material, thing.values)):
                if more is not None:
                    if forces[k] is None:
                        forces[k] = np.zeros((position, deformation)[k].shape)
                    forces[k][0] += more
        return forces[0], forces[1]
