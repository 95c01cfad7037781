"""Marker positions of one sequence as a function of the belief, with derivatives by its parameters."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from threading import Event

import numpy as np

from mphygs.capture.format import Capture
from mphygs.capture.record import Sequence as Recording
from mphygs.model.belief import Belief, Parameter
from mphygs.simulate.batches import Batch, Owned, batches_of
from mphygs.simulate.body import Body
from mphygs.simulate.errors import Halted
from mphygs.simulate.feedback import Feedback
from mphygs.simulate.fields import core_inputs
from mphygs.simulate.measured_start import start_numbers, start_sequence
from mphygs.simulate.measurement import with_measurement_faults
from mphygs.simulate.predicted import Prediction, Started, readings_of
from mphygs.simulate.scope import (
    acts_in_simulation,
    moves_targets,
)
from mphygs.simulate.sequence_model import SequenceModel
from mphygs.simulate.settings import Settings, check_effects
from mphygs.simulate.shorter_steps import in_steps_that_do
from mphygs.simulate.timeline import Timeline
from mphygs.simulate.transfer import Start

# Predictions that are kept, as many with derivatives as without: one fit ends where the next begins, or a
# comparison, and whether a model can be simulated is asked before it is fitted.
KEPT = 3


class Predictor(SequenceModel):
    """Simulates one recorded sequence of a capture at one spacing, by the transfer of the settings."""

    def __init__(
        self, capture: Capture, recording: Recording, settings: Settings, *, body: Body | None = None
    ) -> None:
        """See `SequenceModel`."""
        super().__init__(capture, recording, settings, body=body)
        # Cores that its runs share; one where several predictions run side by side.
        self.workers = max(1, settings.workers)
        # With derivatives, and without.
        self._kept: list[tuple] = []
        self._plain: list[tuple] = []
        self._pull: Feedback | None = None
        self._pulls: dict[float, Feedback] = {}
        self._halt: Event | None = None

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
        self.stop_if_halted()
        last = self.recording.frames if last is None else last
        whole = start is None and not candidates
        feedback = None if feedback is None or feedback.gain == 0.0 else feedback
        known = self._known(belief, last, substep, tuple(keys), feedback) if whole else None
        if known is not None:
            return known
        dt = substep or self.stable_substep(belief)
        timeline = self.timeline(belief, self.end(last), dt, start)
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
        states, tangents, timeline = self._runs(belief, moving, timeline, start, progress, feedback)
        told = dict(zip(slots, tangents, strict=True))
        prediction = self.observed(belief, states, timeline, wanted, told, dt, start, feedback).until(last)
        if whole:
            self.keep(belief, last, substep, prediction, feedback)
        return prediction

    def stop_if_halted(self) -> None:
        """Raises Halted where a twin is told to stop."""
        if self._halt is not None and self._halt.is_set():
            raise Halted(self.recording.name)

    def end(self, last: int) -> int:
        """Frames that a run of frames 0..last-1 takes: instruments are told by the frames to both sides."""
        return min(last + 1, self.recording.frames) if self.instruments else last

    def keep(
        self,
        belief: Belief,
        last: int,
        substep: float | None,
        prediction: Prediction,
        feedback: Feedback | None = None,
    ) -> None:
        """Keep a prediction of a whole sequence, for the next that asks for the same."""
        kept = self._kept if prediction.keys else self._plain
        kept[:] = [*kept[1 - KEPT :], (belief, last, substep, feedback, prediction)]

    def observed(
        self,
        belief: Belief,
        states: tuple,
        timeline: Timeline,
        wanted: Sequence[Owned],
        tangents: Mapping[int, tuple],
        dt: float,
        start: Start | None,
        feedback: Feedback | None = None,
    ) -> Prediction:
        """The prediction that the states of a run are. tangents: of these, by the place among those wanted of
        the parameters that act in the simulation; dt: the substep that was asked for [s]."""
        position, velocity = self.carriers.observe(states, timeline, self.recording)
        jacobian = np.zeros((*position.shape, len(wanted)))
        for slot, tangent in tangents.items():
            jacobian[..., slot] = self.carriers.observe_tangent(states, tangent, timeline)
        readings = readings_of(self.instruments, belief, states, timeline, wanted, tangents)
        end = int(timeline.frames[-1]) + 1
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
        return Prediction(
            timeline.frames,
            position,
            velocity,
            jacobian,
            names,
            timeline.substeps,
            timeline.longest,
            readings,
        )

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
        states, _, timeline = self._runs(moved, [], timeline, None, None, feedback)
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
    ) -> tuple[tuple, list[tuple], Timeline]:
        """The states, their tangent by every owned parameter, and the timeline, in steps that do."""
        (states, tangents), timeline = in_steps_that_do(
            timeline, lambda one: self._run_on(one, belief, owned, start, progress, feedback)
        )
        return states, tangents, timeline

    def _run_on(
        self,
        timeline: Timeline,
        belief: Belief,
        owned: Sequence[Owned],
        start: Start | None,
        progress: Callable[[int], bool] | None,
        feedback: Feedback | None,
    ) -> tuple[tuple, list[tuple]]:
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
