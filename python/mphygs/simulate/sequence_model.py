"""What is simulated of one sequence at a belief: models, steps in time, fields of the core."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from mphygs import _core
from mphygs.capture.format import Capture
from mphygs.capture.record import Sequence as Recording
from mphygs.capture.sensors import FORCE
from mphygs.model.belief import Belief
from mphygs.scene.spacing_worth import usual_spacing
from mphygs.simulate.actuation import Actuation, acts_by_channels
from mphygs.simulate.batches import Owned
from mphygs.simulate.body import Body, hold_boxes
from mphygs.simulate.discretisation import discretise
from mphygs.simulate.fields import core_effects, core_input_tangent, core_inputs, places
from mphygs.simulate.instruments import Instrument, check_force_sensors, instrument_of
from mphygs.simulate.marker_carriers import Carriers
from mphygs.simulate.material_points import MaterialPoints
from mphygs.simulate.measured_start import MeasuredStart, start_numbers, start_sequence
from mphygs.simulate.measurement import lateness
from mphygs.simulate.particle_body import discretise_particles
from mphygs.simulate.prestress import RestShape
from mphygs.simulate.reactions import reaction_weights
from mphygs.simulate.scope import (
    acts_in_simulation,
    belief_of_sequence,
    in_scope,
    is_absent,
    stated_weights,
)
from mphygs.simulate.settings import AUTO, IMPLICIT, MLS, TRANSFERS, Settings, check_effects, check_integrator
from mphygs.simulate.step_choice import steps_to_predict
from mphygs.simulate.timeline import Timeline, poses_of, timeline_of
from mphygs.simulate.total_lagrangian import TotalLagrangian
from mphygs.simulate.transfer import Start, Transfer
from mphygs.simulate.user_effects import forces_of


class SequenceModel:
    """One recorded sequence of a capture at one spacing, for the transfer of the settings."""

    def __init__(
        self, capture: Capture, recording: Recording, settings: Settings, *, body: Body | None = None
    ) -> None:
        """body: of an earlier one with the same holds and settings, to be shared. Raises ValueError for
        an unknown transfer, or where a hold or the spacing does not suit the object."""
        self.capture, self.recording, self.settings = capture, recording, settings
        if settings.transfer not in TRANSFERS:
            raise ValueError(f"transfer '{settings.transfer}': expected one of {', '.join(TRANSFERS)}")
        check_integrator(settings.transfer, settings.integrator)
        particles = settings.transfer == MLS
        make = discretise_particles if particles else discretise
        body = body or make(capture, hold_boxes(recording), settings.spacing)
        if body.turn is not recording.turn:
            body = replace(body, turn=recording.turn)
        self.transfer: Transfer = (MaterialPoints if particles else TotalLagrangian)(body, settings)
        if recording.markers is not None:
            self.attachment = body.attach(recording.markers.at)
        self._stable: tuple[Belief, float] | None = None
        self._start = MeasuredStart(capture, recording, self.transfer)
        self.actuation = Actuation(recording, self.transfer)
        if self.actuation.core is not None:
            self.transfer.actuate(self.actuation.core)
        check_force_sensors(recording, self.actuation.held)

    @property
    def body(self) -> Body:
        """The body that the transfer simulates."""
        return self.transfer.body

    @property
    def rest_shape(self) -> RestShape:
        """What tells the shape that bears the loads at rest."""
        return self.transfer.rest_shape

    @cached_property
    def carriers(self) -> Carriers:
        """What carries the sequence's markers."""
        return self.transfer.carriers(self.attachment)

    @cached_property
    def instruments(self) -> tuple[Instrument, ...]:
        """What reads the sequence's sensors. Raises ValueError for one that the transfer does not have."""
        return tuple(instrument_of(s, self.transfer, self.recording) for s in self.recording.sensors)

    @cached_property
    def steps_a_frame(self) -> int:
        """Of implicit steps, as the capture's sequence of the name and the grid ask for, whatever points are
        followed."""
        every = self.capture.sequences
        own = next((s for s in every if s.name == self.recording.name), self.recording)
        finer = usual_spacing(self.capture.parts) / self.settings.spacing
        return steps_to_predict(own, every, paired=self.body.curved, finer=finer)

    # ---- models, substeps ---------------------------------------------------------------------
    def model(
        self, active: tuple[str, ...], spots: np.ndarray, law: str, *, implicit: bool = False
    ) -> object:
        """The compiled model with core effects and effects at spots, (K, 3) [m], for such steps."""
        return self.transfer.model(active, spots, law, implicit=implicit)

    def model_of(self, belief: Belief) -> object:
        """The compiled model of a belief. Raises ValueError for an effect that the transfer cannot have."""
        check_effects(self.settings.transfer, belief.effects)
        return self.model(
            core_effects(belief), places(belief), belief.law, implicit=self.implicit(belief)
        )

    def stable_substep(self, belief: Belief) -> float:
        """The longest substep of a run [s]: that of stability, of implicit ones a share of a frame."""
        return self._implicit_step if self.implicit(belief) else self._explicit_substep(belief)

    def implicit(self, belief: Belief) -> bool:
        """Whether a run takes implicit steps: where the settings say so, or it costs less by far, and with
        rods and shells always, through whose thickness an explicit step would be as short as sound takes.

        Both are counted in operations, so that the choice is the same on every machine.
        """
        if self.body.curved:
            return True
        if self.settings.integrator != AUTO:
            return self.settings.integrator == IMPLICIT
        if self.settings.transfer == MLS:
            return False
        return self.transfer.implicit_cost * self._explicit_substep(belief) < self._implicit_step

    @property
    def _implicit_step(self) -> float:
        return 1.0 / (self.steps_a_frame * self.recording.fps)

    def _explicit_substep(self, belief: Belief) -> float:
        if self.settings.integrator != AUTO:
            return self._cfl_substep(belief)
        # Asked for twice of every belief.
        known = self._stable
        if known is None or known[0] is not belief:
            known = self._stable = belief, self._cfl_substep(belief)
        return known[1]

    def _cfl_substep(self, belief: Belief) -> float:
        """Substep from the CFL condition, elastic and viscous [s].

        Symplectic Euler with damping c is stable while omega^2 dt^2 + 2 c dt < 4; omega and c are the
        largest rates of the linearised model, found by power iteration.
        """
        check_effects(self.settings.transfer, belief.effects)
        model = self.model(core_effects(belief), places(belief), belief.law)
        fields = core_inputs(belief_of_sequence(belief, self.recording.name), self.body)
        active = list(core_effects(belief))
        fields["effect"] = _core.worst_case(fields["effect"], active)
        if self.actuation.core is not None:
            fields["channel"] = self.actuation.largest(belief)
        hook = self._hook(belief, fields, number=self.settings.number)
        stiffness, damping = self.transfer.largest_rates(model, fields, hook)
        stiffness *= _core.stiffness_factor(fields["effect"], active)
        limit = (-damping + np.sqrt(damping**2 + 4.0 * stiffness)) / stiffness
        return self.settings.safety * float(limit)

    def start(self, belief: Belief) -> Start | None:
        """The state in frame 0 of a sequence that does not begin at rest, None of others."""
        return self._start.at(belief, lateness(belief))

    def release_shift(self, belief: Belief) -> float:
        """How much later than stated a belief has the release [s]."""
        key = f"{self.recording.name}.release_shift"
        return belief[key].value if key in belief else 0.0

    def timeline(self, belief: Belief, last: int, substep: float, start: Start | None = None) -> Timeline:
        """Frames 0..last-1, or from the start's on, and the substeps between them."""
        measured_start = start_numbers(belief, self.recording.name) is not None
        return timeline_of(
            self.recording,
            last,
            substep,
            release_shift=self.release_shift(belief),
            late=lateness(belief),
            first=start.frame if start is not None else 0 if measured_start else None,
            implicit=self.implicit(belief),
            paired=self.body.curved,
        )

    def schedule(self, timeline: Timeline) -> dict:
        """The timeline's, which asks for the reactions of the holds where a sensor reads them."""
        if not any(sensor.kind == FORCE for sensor in self.recording.sensors):
            return timeline.schedule
        return timeline.schedule | {"reaction_weight": reaction_weights(timeline.schedule)}

    # ---- fields -------------------------------------------------------------------------------
    def inputs(self, belief: Belief, timeline: Timeline, start: Start | None = None) -> dict[str, np.ndarray]:
        """All fields of the core for this sequence."""
        return self._material(belief, start) | self._imposed(belief, timeline)

    def _material(self, belief: Belief, start: Start | None) -> dict[str, np.ndarray]:
        """Fields of the belief and of the initial state."""
        fields = core_inputs(belief_of_sequence(belief, self.recording.name), self.body)
        if belief.prestress == "equilibrium":
            fields |= self.transfer.prestressed(belief)
        start = start or self.start(belief)
        return fields if start is None else self.transfer.begun(fields, start)

    def _imposed(self, belief: Belief, timeline: Timeline) -> dict[str, np.ndarray]:
        """Motions of the holds and known loads."""
        fields = {}
        if self.recording.held:
            fields["pose"] = poses_of(self.recording, timeline)
        lifted = [name for name in stated_weights(belief) if in_scope(belief, name, self.recording.name)]
        if self.recording.loads or lifted:
            force = self._loads(timeline)
            for name in lifted:
                (mass,) = belief.values_of(name).values()
                force = force + mass * self._lift(belief, name, timeline)
            fields["node_force"] = force
        if self.actuation.core is not None:
            fields["channel"] = self.actuation.channels(belief, timeline)
        return fields

    def _loads(self, timeline: Timeline) -> np.ndarray:
        """(F, N, 3) known loads on the carriers, each spread over the material in its box [N]."""
        out = np.zeros((len(timeline.moving), len(self.transfer.places_at_rest()), 3))
        for load in self.recording.loads:
            # Of the interval in which it starts or ends it has the impulse.
            edges = [load.start_frame, np.inf if load.end_frame is None else load.end_frame]
            since = [
                np.clip((timeline.times - edge / self.recording.fps) / timeline.spans, 0.0, 1.0)
                for edge in edges
            ]
            acting = (since[0] - since[1])[:, None, None]
            out += acting * self.transfer.load_share(load)[:, None] * np.asarray(load.force, float)
        return out

    def _lift(self, belief: Belief, name: str, timeline: Timeline) -> np.ndarray:
        """(F, N, 3) force per mass that undoes a point mass's weight, which a known load states [m/s^2]."""
        place = np.asarray(belief.term(name).settings["place"], float)
        force = self.transfer.point_share(place)[:, None] * -self.body.towards(belief.gravity)
        return np.repeat(force[None], len(timeline.moving), axis=0)

    def changes(
        self, belief: Belief, owned: Sequence[Owned], timeline: Timeline, start: Start | None = None
    ) -> list[dict[str, np.ndarray]]:
        """Direction of all fields for each parameter, prestress included."""
        here = self.recording.name
        changes = [
            core_input_tangent(owner, self.body, parameter)
            if acts_in_simulation(parameter)
            and start_sequence(parameter) is None
            and not acts_by_channels(parameter)
            and not is_absent(owner, parameter, here)
            else {}
            for owner, parameter in owned
        ]
        for change, (owner, parameter) in zip(changes, owned, strict=True):
            moved = self.actuation.change(owner, parameter, timeline)
            if moved is not None:
                change["channel"] = moved
        for change, (owner, parameter) in zip(changes, owned, strict=True):
            name = parameter.key.rsplit(".", 1)[0]
            if "place_mass" in change and name in stated_weights(owner):
                change["node_force"] = parameter.slope * self._lift(owner, name, timeline)
        if belief.prestress == "equilibrium":
            self.rest_shape.solve(belief)
            groups: dict[int, list[int]] = {}
            for i, (owner, parameter) in enumerate(owned):
                if self.rest_shape.answers(owner, parameter):
                    groups.setdefault(id(owner), []).append(i)
            # Those that one solution serves come first: every other one takes its place.
            rests = {i: self.rest_shape.rests_as(owned[own[0]][0], belief) for i, own in groups.items()}
            for _, indices in sorted(groups.items(), key=lambda item: not rests[item[0]]):
                owner = owned[indices[0]][0]
                slopes = self.transfer.prestress_slopes(owner, [owned[i][1] for i in indices], belief)
                for i, slope in zip(indices, slopes, strict=True):
                    changes[i] |= slope
            self.rest_shape.solve(belief)
        state = start or self.start(belief)
        if state is not None:
            changes = [self.transfer.begun_change(c, state) for c in changes]
        own = [i for i, (_, parameter) in enumerate(owned) if start_sequence(parameter) == here]
        if own and start is None:
            rest = self.transfer.prestressed(belief) if belief.prestress == "equilibrium" else {}
            slopes = self._start.slopes(belief, [owned[i][1] for i in own], lateness(belief))
            for i, slope in zip(own, slopes, strict=True):
                changes[i] = self.transfer.begun_slope(rest, slope)
        return changes

    def _hook(
        self,
        belief: Belief,
        fields: dict,
        simulated: Sequence[Owned] = (),
        changes: Sequence[dict] = (),
        number: type | None = None,
    ) -> object | None:
        """What the effects in Python add to a run, if there are any. number: of the model, None for that
        of the belief's own runs."""
        if number is None:
            number = np.float64 if self.implicit(belief) else self.settings.number
        return forces_of(
            belief, self.body, number, fields["mass"], simulated=simulated, changes=changes
        )
