"""Marker positions of one sequence as a function of the belief, with derivatives by its parameters."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import cached_property
from threading import Event

import numpy as np

from mphygs import _core
from mphygs.capture.format import Capture
from mphygs.capture.record import Sequence as Recording
from mphygs.capture.sensors import FORCE
from mphygs.model.belief import Belief, Parameter
from mphygs.model.registry import effect
from mphygs.simulate.actuation import Actuation, acts_by_channels
from mphygs.simulate.batches import Batch, Owned, batches_of
from mphygs.simulate.body import Body, discretise, hold_boxes
from mphygs.simulate.errors import Halted
from mphygs.simulate.feedback import Feedback
from mphygs.simulate.fields import core_effects, core_input_tangent, core_inputs, places
from mphygs.simulate.instruments import Instrument, check_force_sensors, instrument_of
from mphygs.simulate.marker_carriers import Carriers
from mphygs.simulate.material_points import MaterialPoints
from mphygs.simulate.measured_start import MeasuredStart, start_numbers, start_sequence
from mphygs.simulate.measurement import lateness, with_measurement_faults
from mphygs.simulate.particle_body import discretise_particles
from mphygs.simulate.predicted import Prediction, Started, readings_of
from mphygs.simulate.prestress import RestShape
from mphygs.simulate.reactions import reaction_weights
from mphygs.simulate.scope import belief_of_sequence, in_scope, is_absent, stated_weights
from mphygs.simulate.settings import AUTO, IMPLICIT, MLS, TRANSFERS, Settings, check_effects, check_integrator
from mphygs.simulate.timeline import Timeline, poses_of, timeline_of
from mphygs.simulate.total_lagrangian import TotalLagrangian
from mphygs.simulate.transfer import Start, Transfer
from mphygs.simulate.user_effects import forces_of

# Predictions that are kept, as many with derivatives as without: one fit ends where the next begins, or a
# comparison, and whether a model can be simulated is asked before it is fitted.
KEPT = 3
# Of implicit steps. A swing of a sixth of the frame rate falls behind by 0.1 % of its period then; in steps
# twice as long by 0.5 %, which markers show.
STEPS_A_FRAME = 8
# Explicit substeps that cost as much as an implicit step, at most: see benchmarks/implicit.
WORTH_AN_IMPLICIT_STEP = 160


class Predictor:
    """Simulates one recorded sequence of a capture at one spacing, by the transfer of the settings."""

    def __init__(
        self, capture: Capture, recording: Recording, settings: Settings, *, body: Body | None = None
    ) -> None:
        """body: of an earlier predictor with the same holds and settings, to be shared. Raises ValueError for
        an unknown transfer, or where a hold or the spacing does not suit the object."""
        self.capture, self.recording, self.settings = capture, recording, settings
        # Cores that its runs share; one where several predictions run side by side.
        self.workers = max(1, settings.workers)
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
        # With derivatives, and without.
        self._kept: list[tuple] = []
        self._plain: list[tuple] = []
        self._pull: Feedback | None = None
        self._pulls: dict[float, Feedback] = {}
        self._halt: Event | None = None
        self._stable: tuple[Belief, float] | None = None
        self._start = MeasuredStart(capture, recording, self.transfer)
        self.actuation = Actuation(recording, self.transfer)
        if self.actuation.core is not None:
            self.transfer.actuate(self.actuation.core)
        check_force_sensors(recording, self.actuation.held)

    def twin(self, workers: int, halt: Event | None = None) -> Predictor:
        """The same predictor, for another thread: of the same body, with models of its own.

        workers: cores that its runs share; halt: set once no more of them are wanted.
        """
        twin = self.alike(replace(self.settings, workers=workers))
        twin._kept, twin._plain, twin._halt = list(self._kept), list(self._plain), halt
        return twin

    def alike(self, settings: Settings) -> Predictor:
        """The same predictor with other settings of the same grid, of the same body."""
        return Predictor(self.capture, self.recording, settings, body=self.body)

    def forget(self) -> None:
        """Drop what earlier runs left, so that what follows does not depend on them to the last bit."""
        self.transfer.forget()
        self._kept, self._plain = [], []

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
        """Whether a run takes implicit steps: where the settings say so, or it costs less by far.

        Both are counted in evaluations of the forces, so that the choice is the same on every machine.
        """
        if self.settings.integrator != AUTO:
            return self.settings.integrator == IMPLICIT
        if self.settings.transfer == MLS:
            return False
        return WORTH_AN_IMPLICIT_STEP * self._explicit_substep(belief) < self._implicit_step

    @property
    def _implicit_step(self) -> float:
        return 1.0 / (STEPS_A_FRAME * self.recording.fps)

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
        )

    def schedule(self, timeline: Timeline) -> dict:
        """The timeline's, which asks for the reactions of the holds where a sensor reads them."""
        if not any(sensor.kind == FORCE for sensor in self.recording.sensors):
            return timeline.schedule
        return timeline.schedule | {"reaction_weight": reaction_weights(timeline.schedule)}

    # ---- fields -------------------------------------------------------------------------------
    def inputs(self, belief: Belief, timeline: Timeline, start: Start | None = None) -> dict[str, np.ndarray]:
        """All fields of the core for this sequence."""
        fields = self._material(belief, start)
        return fields | self._imposed(belief, timeline)

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

    # ---- runs ---------------------------------------------------------------------------------
    def predict(
        self,
        belief: Belief,
        *,
        last: int | None = None,
        keys: Sequence[str] = (),
        candidates: Sequence[Owned] = (),
        substep: float | None = None,
        start: Start | None = None,
        feedback: Feedback | None = None,
        progress: Callable[[int], bool] | None = None,
    ) -> Prediction:
        """Positions of the markers in frames 0..last-1, and derivatives; those of the same belief, keys and
        frames as shortly before are not computed again.

        keys: parameters of the belief to differentiate by; candidates: parameters of other beliefs, each
        this one plus an effect at its null, to differentiate by as well (they share the same motion);
        start: a state in mid-motion, whose frame is then the first; feedback: what of the measurement pulls
        the motion, None for a free run.
        Raises SimulationError where the run is unstable, ValueError for an effect that the transfer cannot
        have, Halted where a twin is told to.
        """
        if self._halt is not None and self._halt.is_set():
            raise Halted(self.recording.name)
        last = self.recording.frames if last is None else last
        whole = start is None and not candidates
        feedback = None if feedback is None or feedback.gain == 0.0 else feedback
        known = self._known(belief, last, substep, tuple(keys), feedback) if whole else None
        if known is not None:
            return known
        dt = substep or self.stable_substep(belief)
        # Instruments are told by the frames to both sides.
        end = min(last + 1, self.recording.frames) if self.instruments else last
        timeline = self.timeline(belief, end, dt, start)
        wanted = [(belief, belief[key]) for key in keys] + list(candidates)
        slots = [
            k
            for k, (_, parameter) in enumerate(wanted)
            if acts_in_simulation(parameter)
            and start_sequence(parameter) in (None, self.recording.name)
            or feedback is not None
            and moves_targets(parameter)
        ]
        moving = [wanted[k] for k in slots]
        states, tangents = self._runs(belief, moving, timeline, start, progress, feedback)
        position, velocity = self.carriers.observe(states, timeline, self.recording)
        jacobian = np.zeros((*position.shape, len(wanted)))
        for slot, tangent in zip(slots, tangents, strict=True):
            jacobian[..., slot] = self.carriers.observe_tangent(states, tangent, timeline)
        told = dict(zip(slots, tangents, strict=True))
        readings = readings_of(self.instruments, belief, states, timeline, wanted, told)
        begins = start is None and start_numbers(belief, self.recording.name) is not None
        for slot, (owner, parameter) in enumerate(wanted):
            if parameter.key == f"{self.recording.name}.release_shift" and start is None:
                later = self._started(belief, parameter, end, dt, feedback)
                jacobian[..., slot] = (later.position - position) * later.slope
                for reading, moved in zip(readings, later.readings, strict=True):
                    reading.jacobian[..., slot] = (moved - reading.value) * later.slope
            if parameter.key == "time_offset.offset" and begins:
                # What frame 0 shows is the start whenever it was taken: a late clock moves holds and loads.
                later = self._started(owner, parameter, end, dt, feedback)
                jacobian[..., slot] = (later.position - position) * later.slope - velocity * parameter.slope
        times = timeline.frames / self.recording.fps
        position, velocity, jacobian = with_measurement_faults(
            belief, wanted, times, position, velocity, jacobian
        )
        names = tuple(p.key for _, p in wanted)
        prediction = Prediction(
            timeline.frames,
            position,
            velocity,
            jacobian,
            names,
            timeline.substeps,
            timeline.longest,
            readings,
        ).until(last)
        if whole:
            kept = self._kept if names else self._plain
            kept[:] = [*kept[1 - KEPT :], (belief, last, substep, feedback, prediction)]
        return prediction

    def _known(
        self,
        belief: Belief,
        last: int,
        substep: float | None,
        keys: tuple[str, ...],
        feedback: Feedback | None,
    ) -> Prediction | None:
        """One of the latest predictions, where it is the one that is asked for."""
        for of, until, step, pull, prediction in (*self._kept, *self._plain):
            same = of is belief and pull is feedback and (until, step) == (last, substep)
            if same and keys in ((), prediction.keys):
                if keys:
                    return prediction
                return prediction.without_slopes()
        return None

    def states(
        self,
        belief: Belief,
        timeline: Timeline,
        start: Start | None = None,
        feedback: Feedback | None = None,
    ) -> tuple:
        """Displacement [m] and velocity [m/s] of all carriers at the run's frames, (S, N, 3) each."""
        return self._runs(belief, [], timeline, start, None, feedback)[0]

    def pulled_by(self, position: np.ndarray, gain: float) -> Feedback:
        """What pulls the motion towards measured markers (T, M, 3) [m], kept. gain: see `Feedback`."""
        if self._pull is None or self._pull.position is not position:
            self._pull = Feedback.of(self.recording, self.carriers, self.transfer, position)
            self._pulls = {1.0: self._pull}
        if gain not in self._pulls:
            self._pulls[gain] = self._pull.scaled(gain)
        return self._pulls[gain]

    def von_mises(self, belief: Belief, last: int, feedback: Feedback | None = None) -> np.ndarray:
        """Von Mises stress of the base law at the quadrature points, (T, B, 8) [Pa], at frames 0..last-1."""
        timeline = self.timeline(belief, last, self.stable_substep(belief))
        f = self.transfer.deformation(self.states(belief, timeline, feedback=feedback), belief)
        mu = core_inputs(belief, self.body)["mu"][: f.shape[1]]
        # Kirchhoff deviator of the neo-Hookean law: mu dev(F F^T).
        b = f @ np.swapaxes(f, -1, -2)
        b = b - np.trace(b, axis1=-2, axis2=-1)[..., None, None] / 3.0 * np.eye(3)
        return mu * np.sqrt(1.5 * (b * b).sum((-2, -1)))

    def _started(
        self, belief: Belief, parameter: Parameter, last: int, dt: float, feedback: Feedback | None
    ) -> Started:
        """By a difference: it moves the schedule's start, which the core does not differentiate."""
        step = 0.05 / self.recording.fps
        if parameter.value + step > parameter.upper:
            step = -step
        moved = belief.with_parameter(parameter.key, value=parameter.value + step)
        timeline = self.timeline(moved, last, dt)
        states = self.states(moved, timeline, feedback=feedback)
        later, _ = self.carriers.observe(states, timeline, self.recording)
        readings = tuple(i.read(moved, states, timeline) for i in self.instruments)
        return Started(later, readings, parameter.slope / step)

    def _runs(
        self,
        belief: Belief,
        owned: Sequence[Owned],
        timeline: Timeline,
        start: Start | None,
        progress: Callable[[int], bool] | None,
        feedback: Feedback | None,
    ) -> tuple[tuple, list[tuple]]:
        """The states, and their tangent by every owned parameter."""
        observer = None if feedback is None else feedback.observer(timeline)
        schedule = self.schedule(timeline)
        pull = {} if feedback is None else {"target": feedback.target(belief, timeline)}
        if not owned:
            model = self.model_of(belief)
            fields = self.inputs(belief, timeline, start) | pull
            hook = self._hook(belief, fields)
            self.transfer.share(model, self.workers)
            run = self.transfer.simulate(model, fields, schedule, progress, hook, observer=observer)
            return run, []
        for owner, _ in owned:
            check_effects(self.settings.transfer, owner.effects)
        # As few runs as there can be, side by side; what threads are left share each run's work.
        workers = self.workers
        changes = self.changes(belief, owned, timeline, start)
        for change, (owner, parameter) in zip(changes, owned, strict=True):
            if feedback is not None and moves_targets(parameter):
                change["target"] = feedback.change(owner, parameter, timeline)
        base = self._material(belief, start)
        batches = batches_of(
            belief, self.body, base, owned, changes,
            largest=self.transfer.batch, apart=self.transfer.keeps_apart,
        )  # fmt: skip
        imposed = self._imposed(belief, timeline) | pull
        # Models are made here, one after the other: caches are not shared between threads.
        implicit = self.implicit(belief)
        models = [self.model(b.active, b.spots, belief.law, implicit=implicit) for b in batches]
        for model in models:
            self.transfer.share(model, max(1, workers // len(batches)))

        def run(batch: Batch, model: object) -> list[tuple]:
            fields = batch.fields | imposed
            hook = self._hook(belief, fields, [owned[i] for i in batch.members], batch.directions)
            return self.transfer.tangent(
                model,
                fields,
                batch.directions,
                schedule,
                progress,
                hook,
                batch.apart,
                observer=observer,
            )

        if len(batches) == 1:
            results = [run(batches[0], models[0])]
        else:
            with ThreadPoolExecutor(max(1, min(workers, len(batches)))) as pool:
                results = list(pool.map(run, batches, models))
        tangents: list = [None] * len(owned)
        for batch, result in zip(batches, results, strict=True):
            for i, tangent in zip(batch.members, result[1:], strict=True):
                tangents[i] = tangent
        return results[0][0], tangents


# What makes the predictor of a sequence: capture, recording, settings and body as `Predictor` takes them.
Maker = Callable[..., Predictor]


def moves_targets(parameter: Parameter) -> bool:
    """Whether a parameter changes where the measurement says that markers are: a fault of it."""
    try:
        return effect(parameter.key.rsplit(".", 1)[0]).fault
    except KeyError:
        return False


def acts_in_simulation(parameter: Parameter) -> bool:
    """Whether a parameter changes the motion; the others change what is seen of it, or when it starts."""
    owner = parameter.key.rsplit(".", 1)[0]
    if parameter.key.endswith(".release_shift"):
        return False
    try:
        return not effect(owner).fault
    except KeyError:
        return True
