"""Marker positions of one sequence as a function of the belief, with derivatives by its parameters."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field

import numpy as np

from mphygs.capture.format import Capture
from mphygs.capture.record import Sequence as Recording
from mphygs.model.belief import Belief, Parameter
from mphygs.model.registry import effect
from mphygs.simulate.body import Body, core_model, discretise, hold_boxes
from mphygs.simulate.fields import core_effects, direction, places, primal
from mphygs.simulate.prestress import RestShape
from mphygs.simulate.user_effects import forces_of

# Directions that the core carries at once in one run.
BATCH = 8


@dataclass(frozen=True)
class Settings:
    """How a simulation is run. spacing: [m]; safety: share of the stable substep that is used;
    workers: runs side by side; dtype: "float32" or "float64"; memory_budget: of the adjoint [byte]."""

    spacing: float
    safety: float = 0.7
    workers: int = field(default_factory=lambda: os.cpu_count() or 1)
    dtype: str = "float32"
    memory_budget: int = 2 << 30

    @property
    def number(self) -> type:
        if self.dtype not in ("float32", "float64"):
            raise ValueError(f"dtype '{self.dtype}': expected float32 or float64")
        return np.float32 if self.dtype == "float32" else np.float64


@dataclass(frozen=True, eq=False)
class Prediction:
    """What a model says of a sequence's markers.

    frames: (T,) frame indices; position: (T, M, 3) [m]; velocity: (T, M, 3) [m/s];
    jacobian: (T, M, 3, K) by the coordinates of `keys`; substeps: number computed.
    """

    frames: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    jacobian: np.ndarray
    keys: tuple[str, ...]
    substeps: int
    dt: float


@dataclass(frozen=True, eq=False)
class Timeline:
    """Output frames and substeps of a run. first: the frame before which nothing moves."""

    frames: np.ndarray
    moving: np.ndarray
    schedule: dict
    times: np.ndarray


class Predictor:
    """Simulates one recorded sequence of a capture at one spacing."""

    def __init__(
        self, capture: Capture, recording: Recording, settings: Settings, *, body: Body | None = None
    ) -> None:
        self.capture, self.recording, self.settings = capture, recording, settings
        self.body = body or discretise(capture, hold_boxes(recording), settings.spacing)
        self.rest_shape = RestShape(self.body)
        if recording.markers is not None:
            self.attachment = self.body.attach(recording.markers.at)
        self._models: dict = {}
        self._substep: dict = {}

    # ---- models, substeps ---------------------------------------------------------------------
    def model(self, active: tuple[str, ...], spots: np.ndarray, law: str) -> object:
        key = (tuple(sorted(set(active))), spots.tobytes(), law)
        if key not in self._models:
            body = self.body
            if len(spots):
                geometry = dict(body.geometry) | {"places": spots, "place_cell": body.nearest_cell(spots)}
                body = Body(body.quadrature, geometry, body.boxes, body.part_names, body.centroid, body.parts)
            self._models[key] = core_model(
                body,
                active=key[0],
                dtype=self.settings.number,
                law=law,
                threads=1,
                memory_budget=self.settings.memory_budget,
            )
        return self._models[key]

    def stable_substep(self, belief: Belief) -> float:
        """Substep from the CFL condition, elastic and viscous [s].

        Symplectic Euler with damping c is stable while omega^2 dt^2 + 2 c dt < 4; omega and c are the
        largest rates of the linearised model, found by power iteration.
        """
        model = self.model(core_effects(belief), places(belief), belief.law)
        fields = primal(belief, self.body)
        if "contact" in belief.effects:
            from mphygs.model.registry import core_parameter_offsets

            # Everything touches, without friction: at such depths it would brake without bound.
            first = core_parameter_offsets()["contact"]
            fields["effect"][first], fields["effect"][first + 4] = 100.0, 0.0
        stiffness, damping = model.largest_rates(fields, hook=self._hook(belief, fields))
        if "relaxation" in belief.effects:
            stiffness *= 1.0 + belief["relaxation.ratio"].value
        limit = (-damping + np.sqrt(damping**2 + 4.0 * stiffness)) / stiffness
        return self.settings.safety * float(limit)

    def timeline(self, last: int, substep: float, release_shift: float = 0.0) -> Timeline:
        """Frames 0..last-1 and the substeps between them; motion starts at the release."""
        fps, release = self.recording.fps, self.recording.release
        start = 0.0 if release is None else max(release / fps + release_shift, 0.0)
        frames = np.arange(last)
        moving = frames[frames / fps > start + 1e-9] if release is not None else frames[1:]
        times = moving / fps
        spans = np.diff(np.r_[start, times])
        steps = np.maximum(np.ceil(spans / substep - 1e-9), 1).astype(np.int32)
        return Timeline(
            frames, moving, {"steps": steps, "dt": spans / np.maximum(steps, 1), "start": start}, times
        )

    def substep_times(self, timeline: Timeline) -> np.ndarray:
        """(n + 1,) times of all substep boundaries [s]."""
        s = timeline.schedule
        return s["start"] + np.r_[0.0, np.cumsum(np.repeat(s["dt"], s["steps"]))]

    def poses(self, timeline: Timeline, shift: float = 0.0) -> np.ndarray:
        """(H, n + 1, 12) rigid pose of every hold at every substep."""
        times = self.substep_times(timeline)
        out = np.empty((len(self.recording.held), len(times), 12))
        for h, hold in enumerate(self.recording.held):
            rotation, position = hold.poses(times + shift, self.recording.fps)
            out[h, :, :9] = rotation.reshape(-1, 9)
            out[h, :, 9:] = position
        return out

    def node_force(self, timeline: Timeline, model: object) -> np.ndarray:
        """(F, N, 3) known loads, each spread over the material in its box [N]."""
        q = self.body.quadrature
        points, volumes = q.points.reshape(-1, 3), q.volumes.ravel()
        force = np.zeros((len(timeline.moving), model.node_count, 3))
        for load in self.recording.loads:
            inside = ((points >= load.box[0]) & (points <= load.box[1])).all(1)
            if not inside.any():
                inside[np.abs(points - load.box.mean(0)).sum(1).argmin()] = True
            cell = np.repeat(q.cell, 8, axis=0)[inside]
            node, value, _ = model.weights(points[inside], cell)
            share = volumes[inside] / volumes[inside].sum()
            per_node = np.zeros(model.node_count)
            np.add.at(per_node, node.ravel(), (value * share[:, None]).ravel())
            force[timeline.moving > load.start_frame] += per_node[:, None] * np.asarray(load.force)
        return force

    # ---- runs ---------------------------------------------------------------------------------
    def inputs(self, belief: Belief, timeline: Timeline, model: object) -> dict[str, np.ndarray]:
        """All fields of the core for this sequence."""
        fields = primal(belief, self.body)
        if belief.prestress == "equilibrium":
            solution = self.rest_shape.solve(belief)
            fields["deformation0"] = solution["deformation0"]
            fields["stress_volume"] = self.body.quadrature.volumes * solution["volume_ratio"].reshape(-1, 8)
        if self.recording.held:
            fields["pose"] = self.poses(timeline)
        if self.recording.loads:
            fields["node_force"] = self.node_force(timeline, model)
        return fields

    def predict(
        self,
        belief: Belief,
        *,
        last: int | None = None,
        keys: Sequence[str] = (),
        candidates: Sequence[tuple[Belief, Parameter]] = (),
        substep: float | None = None,
        progress: Callable[[int], bool] | None = None,
    ) -> Prediction:
        """Positions of the markers in frames 0..last-1, and derivatives.

        keys: parameters of the belief to differentiate by; candidates: parameters of other beliefs, each
        this one plus an effect at its null, to differentiate by as well (they share the same motion).
        Raises SimulationError where the run is unstable.
        """
        last = self.recording.frames if last is None else last
        shift = (
            belief[f"{self.recording.name}.release_shift"].value
            if f"{self.recording.name}.release_shift" in belief
            else 0.0
        )
        dt = substep or self.stable_substep(belief)
        timeline = self.timeline(last, dt, shift)
        wanted = [(belief, belief[key]) for key in keys] + list(candidates)
        simulated, slots = [], []
        for slot, (owner, parameter) in enumerate(wanted):
            if acts_in_simulation(parameter):
                simulated.append((owner, parameter))
                slots.append(slot)
        runs = self._runs(belief, simulated, timeline, progress)
        value, tangents = runs
        frames, markers = len(timeline.frames), len(self.attachment.anchor)
        position, velocity = self._observe(value, timeline)
        jacobian = np.zeros((frames, markers, 3, len(wanted)))
        for slot, tangent in zip(slots, tangents, strict=True):
            jacobian[..., slot] = self._observe_tangent(value, tangent, timeline)
        for slot, (_, parameter) in enumerate(wanted):
            if parameter.key.endswith(".release_shift") and parameter.key.startswith(
                f"{self.recording.name}."
            ):
                jacobian[..., slot] = self._release_slope(belief, parameter, last, dt, position)
        position, velocity, jacobian = _measured(
            belief, wanted, timeline.frames / self.recording.fps, position, velocity, jacobian
        )
        return Prediction(
            timeline.frames,
            position,
            velocity,
            jacobian,
            tuple(p.key for _, p in wanted),
            int(timeline.schedule["steps"].sum()),
            float(np.max(timeline.schedule["dt"], initial=0.0)),
        )

    def von_mises(self, belief: Belief, last: int) -> np.ndarray:
        """Von Mises stress of the base law at the quadrature points, (T, B, 8) [Pa], at frames 0..last-1."""
        timeline = self.timeline(last, self.stable_substep(belief))
        value, _ = self._runs(belief, [], timeline, None)
        q = self.body.quadrature
        model = self.model((), np.zeros((0, 3)), belief.law)
        node, _, gradient = model.weights(q.points.reshape(-1, 3), np.repeat(q.cell, 8, axis=0))
        material = primal(belief, self.body)
        mu = material["mu"].ravel()
        start = np.broadcast_to(np.eye(3), (len(mu), 3, 3))
        if belief.prestress == "equilibrium":
            f0 = self.rest_shape.solve(belief)["deformation0"].reshape(-1, 3, 3, 8)
            start = np.moveaxis(f0, -1, 1).reshape(-1, 3, 3)
        out = []
        for u in np.asarray(value[0], float):
            f = (np.eye(3) + np.einsum("pkc,pkj->pcj", u[node], gradient)) @ start
            # Kirchhoff deviator of the neo-Hookean law: mu dev(F F^T).
            b = f @ np.swapaxes(f, -1, -2)
            b = b - np.trace(b, axis1=-2, axis2=-1)[:, None, None] / 3.0 * np.eye(3)
            out.append(mu * np.sqrt(1.5 * np.einsum("pij,pij->p", b, b)))
        return np.array(out).reshape(len(out), -1, 8)

    def _release_slope(
        self, belief: Belief, parameter: Parameter, last: int, dt: float, position: np.ndarray
    ) -> np.ndarray:
        """By a difference: the release moves the schedule's start, which the core does not differentiate."""
        step = 0.05 / self.recording.fps
        if parameter.value + step > parameter.upper:
            step = -step
        moved = belief.with_parameter(parameter.key, value=parameter.value + step)
        timeline = self.timeline(last, dt, parameter.value + step)
        value, _ = self._runs(moved, [], timeline, None)
        return (self._observe(value, timeline)[0] - position) / step * parameter.slope

    def _runs(
        self, belief: Belief, simulated: list, timeline: Timeline, progress: Callable[[int], bool] | None
    ) -> tuple:
        """The trajectory and the tangent of every (belief, parameter)."""
        base_fields: dict = {}
        if not simulated:
            model = self.model(core_effects(belief), places(belief), belief.law)
            fields = self.inputs(belief, timeline, model)
            return model.simulate(fields, timeline.schedule, progress, self._hook(belief, fields)), []
        changes = self.changes(belief, simulated)
        workers = max(1, min(self.settings.workers, len(simulated)))
        size = min(BATCH, -(-len(simulated) // workers))
        # Parameters that need the same effects share a run; others do not pay the rest of an effect's cost.
        order = sorted(range(len(simulated)), key=lambda i: core_effects(simulated[i][0]))
        batches = [order[k : k + size] for k in range(0, len(order), size)]

        def run(batch: list[int]) -> list:
            active = tuple(
                sorted({n for i in batch for n in core_effects(simulated[i][0])} | set(core_effects(belief)))
            )
            spots, shared, fields, directions = self._merge(
                belief, [simulated[i][0] for i in batch], [changes[i] for i in batch]
            )
            model = self.model(active, spots, belief.law)
            fields = base_fields | fields
            if self.recording.held:
                fields["pose"] = self.poses(timeline)
            if self.recording.loads:
                fields["node_force"] = self.node_force(timeline, model)
            hook = self._hook(belief, fields, [simulated[i] for i in batch], directions)
            return model.tangent(fields, directions, timeline.schedule, progress, hook)

        # Models and fields are made here, one after the other: caches are not shared between threads.
        for batch in batches:
            spots, *_ = self._merge(belief, [simulated[i][0] for i in batch], [changes[i] for i in batch])
            active = tuple(
                sorted({n for i in batch for n in core_effects(simulated[i][0])} | set(core_effects(belief)))
            )
            self.model(active, spots, belief.law)
        if len(batches) == 1:
            results = [run(batches[0])]
        else:
            with ThreadPoolExecutor(workers) as pool:
                results = list(pool.map(run, batches))
        tangents: list = [None] * len(simulated)
        for batch, result in zip(batches, results, strict=True):
            for i, tangent in zip(batch, result[1:], strict=True):
                tangents[i] = tangent
        return results[0][0], tangents

    def _hook(
        self,
        belief: Belief,
        fields: dict,
        simulated: Sequence[tuple[Belief, Parameter]] = (),
        changes: Sequence[dict] = (),
    ) -> object | None:
        """What the effects in Python add to a run, if there are any."""
        return forces_of(
            belief, self.body, self.settings.number, fields["mass"], simulated=simulated, changes=changes
        )

    def changes(self, belief: Belief, simulated: list) -> list[dict[str, np.ndarray]]:
        """Direction of all fields for each parameter, prestress included."""
        changes = [direction(owner, self.body, parameter) for owner, parameter in simulated]
        if belief.prestress == "equilibrium":
            self.rest_shape.solve(belief)
            volumes = self.body.quadrature.volumes
            groups: dict[int, list[int]] = {}
            for i, (owner, _) in enumerate(simulated):
                groups.setdefault(id(owner), []).append(i)
            for indices in groups.values():
                owner = simulated[indices[0]][0]
                slopes = self.rest_shape.tangent(owner, [simulated[i][1] for i in indices])
                for i, slope in zip(indices, slopes, strict=True):
                    changes[i]["deformation0"] = slope["deformation0"]
                    changes[i]["stress_volume"] = volumes * slope["volume_ratio"].reshape(-1, 8)
            self.rest_shape.solve(belief)
        return changes

    def _merge(self, belief: Belief, owners: list[Belief], changes: list[dict]) -> tuple:
        """Value fields and directions of one batch whose owners add effects (at places of their own)."""
        spots = places(belief)
        base = primal(belief, self.body)
        if belief.prestress == "equilibrium":
            solution = self.rest_shape.solve(belief)
            base["deformation0"] = solution["deformation0"]
            base["stress_volume"] = self.body.quadrature.volumes * solution["volume_ratio"].reshape(-1, 8)
        merged = dict(base)
        from mphygs.model.registry import core_parameter_nulls

        nulls = np.array(core_parameter_nulls())
        own, masses, points = [spots], [base["place_mass"]], [base["place_effect"]]
        slots = []
        count = len(spots)
        for owner in owners:
            fields = primal(owner, self.body)
            # An effect that only this owner has brings its constants (directions, shapes) along.
            differs = (fields["effect"] != base["effect"]) & (base["effect"] == nulls)
            merged["effect"] = np.where(differs, fields["effect"], merged["effect"])
            extra = places(owner)[len(spots) :]
            slots.append((count, len(extra)))
            own.append(extra)
            masses.append(fields["place_mass"][len(spots) :])
            points.append(fields["place_effect"][len(spots) :])
            count += len(extra)
        merged["place_mass"], merged["place_effect"] = np.concatenate(masses), np.concatenate(points)
        directions = []
        for (begin, extra), change in zip(slots, changes, strict=True):
            moved = dict(change)
            for name in ("place_mass", "place_effect"):
                if name in moved:
                    full = np.zeros_like(merged[name])
                    full[: len(spots)] = moved[name][: len(spots)]
                    full[begin : begin + extra] = moved[name][len(spots) :]
                    moved[name] = full
            directions.append(moved)
        return np.concatenate(own), base, merged, directions

    # ---- what is seen ---------------------------------------------------------------------------
    def marker_weights(self) -> tuple:
        """Free markers (M,) bool; of these: node (F, 27), value, gradient [1/m], and which have an offset."""
        if not hasattr(self, "_marker_weights"):
            model = self.model((), np.zeros((0, 3)), "neo-hookean")
            free = self.attachment.hold < 0
            node, value, gradient = model.weights(self.attachment.anchor[free], self.attachment.cell[free])
            turning = np.linalg.norm(self.attachment.offset[free], axis=1) > 1e-7
            self._marker_weights = (free, node, value, gradient, turning)
        return self._marker_weights

    def _observe(self, trajectory: tuple, timeline: Timeline) -> tuple[np.ndarray, np.ndarray]:
        """Marker positions and velocities, (T, M, 3)."""
        free, node, value, gradient, turning = self.marker_weights()
        a = self.attachment
        frames = len(timeline.frames)
        resting = frames - len(timeline.moving)
        position = np.broadcast_to(a.anchor + a.offset, (frames, *a.anchor.shape)).copy()
        velocity = np.zeros_like(position)
        u, v = (np.asarray(x, float) for x in trajectory)
        if resting and len(timeline.moving) and self.recording.release is None:
            u, v = u, v  # frame 0 is the initial state
        elif len(timeline.moving):
            u, v = u[1:], v[1:]
        shown = slice(resting, frames) if self.recording.release is not None else slice(0, frames)
        moved = np.einsum("mk,tmkc->tmc", value, u[:, node])
        position[shown, free] += moved
        velocity[shown, free] = np.einsum("mk,tmkc->tmc", value, v[:, node])
        if turning.any():
            rotation, _ = self.rotations(u, node[turning], gradient[turning])
            index = np.flatnonzero(free)[turning]
            offset = a.offset[index]
            position[shown, index] += np.einsum("tmij,mj->tmi", rotation, offset) - offset
        times = timeline.frames / self.recording.fps
        for h, hold in enumerate(self.recording.held):
            held = np.flatnonzero(a.hold == h)
            if len(held):
                rest = a.anchor[held] + a.offset[held]
                r, p = hold.poses(times, self.recording.fps)
                step = 1e-4
                r1, p1 = hold.poses(times + step, self.recording.fps)
                r0, p0 = hold.poses(times - step, self.recording.fps)
                position[:, held] = np.einsum("tij,mj->tmi", r, rest) + p[:, None]
                velocity[:, held] = (np.einsum("tij,mj->tmi", r1 - r0, rest) + (p1 - p0)[:, None]) / (
                    2 * step
                )
        return position, velocity

    @staticmethod
    def rotations(u: np.ndarray, node: np.ndarray, gradient: np.ndarray) -> tuple[np.ndarray, tuple]:
        """Polar rotation of the deformation at attached points, (T, M, 3, 3), and its SVD."""
        f = np.einsum("tmkc,mkj->tmcj", u[:, node], gradient) + np.eye(3)
        left, singular, right = np.linalg.svd(f)
        return left @ right, (left, singular, right)

    def _observe_tangent(self, value: tuple, tangent: tuple, timeline: Timeline) -> np.ndarray:
        """Derivative of the marker positions, (T, M, 3)."""
        free, node, weight, gradient, turning = self.marker_weights()
        a = self.attachment
        frames = len(timeline.frames)
        out = np.zeros((frames, len(a.anchor), 3))
        u, du = np.asarray(value[0], float), np.asarray(tangent[0], float)
        shown = slice(0, frames)
        if self.recording.release is not None:
            u, du = u[1:], du[1:]
            shown = slice(frames - len(timeline.moving), frames)
        out[shown, free] = np.einsum("mk,tmkc->tmc", weight, du[:, node])
        if turning.any():
            _, (left, singular, right) = self.rotations(u, node[turning], gradient[turning])
            df = np.einsum("tmkc,mkj->tmcj", du[:, node[turning]], gradient[turning])
            # dR = U ((W - W^T) / (s_i + s_j)) V^T with W = U^T dF V.
            w = np.swapaxes(left, -1, -2) @ df @ np.swapaxes(right, -1, -2)
            skew = (w - np.swapaxes(w, -1, -2)) / (singular[..., :, None] + singular[..., None, :])
            out[shown, np.flatnonzero(free)[turning]] += np.einsum(
                "tmij,mj->tmi", left @ skew @ right, a.offset[np.flatnonzero(free)[turning]]
            )
        return out


def acts_in_simulation(parameter: Parameter) -> bool:
    """Whether a parameter changes the motion; the others change what is seen of it, or when it starts."""
    owner = parameter.key.rsplit(".", 1)[0]
    if parameter.key.endswith(".release_shift"):
        return False
    try:
        return effect(owner).site != "measurement"
    except KeyError:
        return True


def _measured(
    belief: Belief,
    wanted: list,
    times: np.ndarray,
    position: np.ndarray,
    velocity: np.ndarray,
    jacobian: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Faults of the measurement, applied to what the simulation says."""
    if "time_offset" in belief.effects:
        position, velocity = _shifted(times, position, velocity, belief["time_offset.offset"].value)
    t = times[:, None, None]
    for slot, (_, parameter) in enumerate(wanted):
        owner, _, quantity = parameter.key.rpartition(".")
        if owner == "time_offset":
            jacobian[..., slot] = velocity * parameter.slope
        elif owner == "length_scale":
            jacobian[..., slot] = position * parameter.slope
        elif owner == "frame_drift":
            axis = np.eye(3)["xyz".index(quantity[-1])]
            moved = np.broadcast_to(axis, position.shape) if quantity[0] == "v" else np.cross(axis, position)
            jacobian[..., slot] = t * moved * parameter.slope
    if "frame_drift" in belief.effects:
        v = np.array([belief[f"frame_drift.v_{a}"].value for a in "xyz"])
        w = np.array([belief[f"frame_drift.w_{a}"].value for a in "xyz"])
        position = position + t * (v + np.cross(w, position))
    if "length_scale" in belief.effects:
        factor = 1.0 + belief["length_scale.scale"].value
        position, velocity = position * factor, velocity * factor
        jacobian = jacobian * factor
    return position, velocity, jacobian


def _shifted(
    times: np.ndarray, position: np.ndarray, velocity: np.ndarray, shift: float
) -> tuple[np.ndarray, np.ndarray]:
    """State at times + shift, by the cubic through positions and velocities of the frames."""
    if len(times) < 2:
        return position, velocity
    at = np.clip(times + shift, times[0], times[-1])
    k = np.clip(np.searchsorted(times, at, side="right") - 1, 0, len(times) - 2)
    span = (times[k + 1] - times[k])[:, None, None]
    s = ((at - times[k])[:, None, None]) / span
    p0, p1, v0, v1 = position[k], position[k + 1], velocity[k] * span, velocity[k + 1] * span
    cubic = p0 + s * v0 + s**2 * (3 * (p1 - p0) - 2 * v0 - v1) + s**3 * (2 * (p0 - p1) + v0 + v1)
    slope = (v0 + 2 * s * (3 * (p1 - p0) - 2 * v0 - v1) + 3 * s**2 * (2 * (p0 - p1) + v0 + v1)) / span
    return cubic, slope
