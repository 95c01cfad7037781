"""One sequence's motion under further forces on the nodes, with its derivatives by these forces."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from mphygs.model.belief import Belief
from mphygs.simulate.measurement import before_measurement, with_measurement_faults
from mphygs.simulate.prediction import Predictor
from mphygs.simulate.scope import acts_in_simulation
from mphygs.simulate.shorter_steps import in_steps_that_do
from mphygs.simulate.timeline import Timeline

# Of the time between frames: the difference that gives the slope by a release.
RELEASE_STEP = 0.05


@dataclass(frozen=True, eq=False)
class ForcedMotion:
    """A run and what it was made of.

    force: (T, N, 3) [N]; fields: of the core; displacement [m], velocity [m/s]: (F + 1, N, 3) of the nodes at
    the start and at the moving frames; position: (T, M, 3) [m] of the markers as they are measured.
    """

    belief: Belief
    timeline: Timeline
    force: np.ndarray
    fields: dict[str, np.ndarray]
    displacement: np.ndarray
    velocity: np.ndarray
    position: np.ndarray

    @property
    def spans(self) -> np.ndarray:
        """(F,) length of the intervals that end at the moving frames [s]."""
        return self.timeline.spans


class ForcedSequence:
    """Frames 0 to last - 1 of one sequence, with forces held constant between frames.

    A force is (T, N, 3) [N]: row t acts on the nodes in the interval that ends at frame t.
    """

    def __init__(self, predictor: Predictor, last: int) -> None:
        self.predictor, self.last = predictor, last

    def model(self, belief: Belief) -> object:
        """The compiled model, all workers sharing its runs."""
        model = self.predictor.model_of(belief)
        self.predictor.transfer.share(model, self.predictor.workers)
        return model

    def timeline(self, belief: Belief) -> Timeline:
        """Frames and substeps at a belief."""
        return self.predictor.timeline(belief, self.last, self.predictor.stable_substep(belief))

    @property
    def _release_key(self) -> str:
        return f"{self.predictor.recording.name}.release_shift"

    def run(self, belief: Belief, force: np.ndarray) -> ForcedMotion:
        """Simulate. Raises SimulationError where the run is unstable."""
        motion, _ = in_steps_that_do(
            self.timeline(belief), lambda timeline: self._run_on(timeline, belief, force)
        )
        return motion

    def _run_on(self, timeline: Timeline, belief: Belief, force: np.ndarray) -> ForcedMotion:
        predictor, model = self.predictor, self.model(belief)
        fields = predictor.inputs(belief, timeline)
        fields["node_force"] = force[timeline.moving] + fields.get("node_force", 0.0)
        hook = predictor._hook(belief, fields)
        u, v = (np.asarray(a, float) for a in model.simulate(fields, timeline.schedule, None, hook))
        position, velocity = predictor.carriers.observe((u, v), timeline, predictor.recording)
        times = timeline.frames / predictor.recording.fps
        none = np.zeros((*position.shape, 0))
        position, *_ = with_measurement_faults(belief, [], times, position, velocity, none)
        return ForcedMotion(belief, timeline, force, fields, u, v, position)

    def gradient(
        self, motion: ForcedMotion, position_bar: np.ndarray, keys: Sequence[str] = ()
    ) -> tuple[np.ndarray, np.ndarray]:
        """Gradient of a loss by the forces, (T, N, 3), and by the coordinates of `keys`, (K,).

        position_bar: derivative of the loss by the marker positions, (T, M, 3); keys: parameters that act in
        the simulation. One checkpointed adjoint run.
        """
        predictor, belief, timeline = self.predictor, motion.belief, motion.timeline
        model = self.model(belief)
        times = timeline.frames / predictor.recording.fps
        states = (motion.displacement, motion.velocity)
        seen = before_measurement(belief, times, position_bar)
        bars = (seen, np.zeros_like(seen))
        bars = predictor.carriers.observe_adjoint(states, timeline, *bars, model.node_count)
        hook = predictor._hook(belief, motion.fields)
        found, _ = model.adjoint(motion.fields, timeline.schedule, *bars, None, hook)
        slopes = []
        parameters = [belief[key] for key in keys]
        changes = predictor.changes(belief, [(belief, p) for p in parameters], timeline)
        for parameter, change in zip(parameters, changes, strict=True):
            slope = sum(
                float(np.vdot(found[n], np.asarray(c, float).ravel()))
                for n, c in change.items()
                if found[n].size
            )
            if hook is not None:
                slope += hook.slope(parameter, change.get("mass"))
            slopes.append(slope)
        force_bar = np.zeros(motion.force.shape)
        force_bar[timeline.moving] = found["node_force"].reshape(-1, *motion.force.shape[1:])
        return force_bar, np.array(slopes)

    def tangents(
        self, motion: ForcedMotion, forces: Sequence[np.ndarray] = (), keys: Sequence[str] = ()
    ) -> np.ndarray:
        """Change of the measured marker positions, (T, M, 3, K + P), by K forces, each (T, N, 3) [N], and by
        the coordinates of P parameters."""
        predictor, belief, timeline = self.predictor, motion.belief, motion.timeline
        wanted = [(belief, belief[key]) for key in keys]
        simulated = [pair for pair in wanted if acts_in_simulation(pair[1])]
        # The parameters come first: effects in Python look theirs up by place.
        directions = [*predictor.changes(belief, simulated, timeline)]
        hook = predictor._hook(belief, motion.fields, simulated, directions)
        directions += [{"node_force": force[timeline.moving]} for force in forces]
        out = np.zeros((*motion.position.shape, len(keys) + len(forces)))
        value = (motion.displacement, motion.velocity)
        slots = [k for k, (_, p) in enumerate(wanted) if acts_in_simulation(p)]
        slots += range(len(keys), len(keys) + len(forces))
        if directions:
            found = self._side_by_side(motion, directions, hook)
            for slot, one in zip(slots, found, strict=True):
                out[..., slot] = predictor.carriers.observe_tangent(value, one, timeline)
        times = timeline.frames / predictor.recording.fps
        seen = predictor.carriers.observe(value, timeline, predictor.recording)
        *_, out = with_measurement_faults(belief, wanted, times, *seen, out)
        for slot, key in enumerate(keys):
            if key == self._release_key:
                out[..., slot] = self._release_slope(motion)
        return np.roll(out, len(forces), axis=-1)

    def _side_by_side(
        self, motion: ForcedMotion, directions: Sequence[dict], hook: object | None
    ) -> list[tuple[np.ndarray, ...]]:
        """The states' tangents, in runs of as many directions as the core carries, alike in size; as many
        runs at once as there are workers for. Effects in Python look directions up by place: in one run."""
        schedule, workers = motion.timeline.schedule, self.predictor.workers
        model = self.model(motion.belief)
        count = -(-len(directions) // self.predictor.transfer.batch)
        if hook is not None or count < 2:
            return model.tangent(motion.fields, list(directions), schedule, None, hook)[1:]
        self.predictor.transfer.share(model, max(1, workers // count))
        ends = [len(directions) * i // count for i in range(count + 1)]
        parts = [directions[begin:end] for begin, end in pairwise(ends)]

        def run(part: Sequence[dict]) -> list[tuple[np.ndarray, ...]]:
            return model.tangent(motion.fields, list(part), schedule, None, None)[1:]

        with ThreadPoolExecutor(min(workers, count)) as pool:
            return [one for found in pool.map(run, parts) for one in found]

    def _release_slope(self, motion: ForcedMotion) -> np.ndarray:
        """By a difference: the release moves the start, which the core does not differentiate."""
        parameter = motion.belief[self._release_key]
        step = RELEASE_STEP / self.predictor.recording.fps
        if parameter.value + step > parameter.upper:
            step = -step
        moved = motion.belief.with_parameter(parameter.key, value=parameter.value + step)
        return (self.run(moved, motion.force).position - motion.position) / step * parameter.slope
