"""An independent simulator: explicit finite elements of second order, by scikit-fem.

It shares no code with the model, only what reads a capture and tells which points lie in a mesh.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from mphygs.capture.format import Capture
from mphygs.capture.record import Sequence as Recording
from mphygs.capture.sensors import ACCELERATION, Sensor
from mphygs.synth.simulated_motion import SimulatedMotion

if TYPE_CHECKING:
    from mphygs.synth.hidden import Hidden
    from mphygs.synth.recipe import Recipe

from mphygs.synth.finite_element_body import KNOWN, FiniteElementBody


def simulate_finite_element(
    capture: Capture,
    recording: Recording,
    recipe: Recipe,
    hidden: Sequence[Hidden],
    spacing: float,
    progress: Callable[[int], bool] | None = None,
) -> SimulatedMotion:
    """True motion of the markers of one recording, by central differences in time.

    spacing: of a grid as fine as the bricks [m]; progress: told the number of frames after release that
    are done. Raises ValueError for objects and effects that it does not know, RuntimeError where the motion
    is unstable or no stress-free shape is found.
    """
    for thing in hidden:
        if thing.kind == "effect" and thing.name not in KNOWN:
            raise ValueError(
                f"the finite-element simulator has no '{thing.name}'; expected some of {', '.join(KNOWN)}"
            )
    # A brick has three nodes each way, a grid cell one of its own: twice the size is as fine.
    body = FiniteElementBody(capture, recording, recipe, hidden, 2.0 * spacing)
    return _run(body, progress)


def _run(body: FiniteElementBody, progress: Callable[[int], bool] | None) -> SimulatedMotion:
    """Markers in all frames: central differences, velocities at the half steps."""
    recording, mesh = body.recording, body.mesh
    places = recording.markers.at
    markers = mesh.weights(places)
    first = recording.release or 0
    steps = math.ceil(1.0 / recording.fps / body.step())
    dt = 1.0 / recording.fps / steps
    begin = first / recording.fps
    times = begin + dt * np.arange(steps * (recording.frames - 1 - first) + 1)
    rotation, shift = body.hold.poses(times, recording.fps)
    gripped = mesh.nodes[body.held]
    u, v = np.zeros_like(mesh.nodes), np.zeros_like(mesh.nodes)
    position = np.repeat(places[None], recording.frames, axis=0)
    velocity = np.zeros_like(position)
    readings = tuple(np.full_like(sensor.value, np.nan) for sensor in recording.sensors)
    for k in range(len(times) - 1):
        half = 0.5 if k == 0 else 1.0
        carried = gripped @ rotation[k + 1].T + shift[k + 1] - gripped
        driven = ((carried - u[body.held]) / dt - v[body.held]) / (half * dt)
        kick, pulls = body.acceleration(u, v, times[k], dt, driven)
        if k % steps == 0:
            for sensor, reading in zip(recording.sensors, readings, strict=True):
                reading[first + k // steps] = _read(body, sensor, kick, pulls, u, rotation[k], shift[k])
        late = v + half * dt * kick
        moved = u + dt * late
        if (k + 1) % steps == 0:
            frame = first + (k + 1) // steps
            position[frame] = places + markers @ moved
            # Half a step on from the half step: the state's own time.
            velocity[frame] = markers @ (late + 0.5 * dt * kick)
            if not np.isfinite(position[frame]).all():
                raise RuntimeError(f"finite elements: unstable before frame {frame}")
            if progress:
                progress(frame - first)
        u, v = moved, late
    _carry(body, places, position, velocity)
    return SimulatedMotion(position, velocity, ~body.in_hold(places), len(times) - 1, readings)


def _read(
    body: FiniteElementBody,
    sensor: Sensor,
    acceleration: np.ndarray,
    pulls: np.ndarray,
    u: np.ndarray,
    rotation: np.ndarray,
    shift: np.ndarray,
) -> np.ndarray:
    """(V, 3) what a sensor reads.

    acceleration: (N, 3) [m/s^2] and displacement u: (N, 3) [m] of the nodes; pulls: (H, 3) of the hold on
    its nodes [N]; rotation: (3, 3), shift: (3,) its pose.
    """
    if sensor.kind == ACCELERATION:
        read = body.mesh.weights(sensor.at[None]) @ acceleration
        felt = {n: v for n, v in body.effects.items() if n == "gravity"}
        return read - body.body_field(np.zeros(3), 0.0, felt) if sensor.gravity else read
    centre = rotation @ np.asarray(body.hold.box, float).mean(axis=0) + shift
    arm = (body.mesh.nodes + u)[body.held] - centre
    both = np.stack([pulls.sum(axis=0), np.cross(arm, pulls).sum(axis=0)])
    return both[: sensor.value.shape[1]]


def _carry(body: FiniteElementBody, places: np.ndarray, position: np.ndarray, velocity: np.ndarray) -> None:
    """Markers on what is held follow it rigidly."""
    held = body.in_hold(places)
    times = np.arange(body.recording.frames) / body.recording.fps
    rotation, shift = body.hold.poses(times, body.recording.fps)
    position[:, held] = np.einsum("tij,mj->tmi", rotation, places[held]) + shift[:, None]
    step = 1e-4
    (r1, p1), (r0, p0) = (body.hold.poses(times + d, body.recording.fps) for d in (step, -step))
    velocity[:, held] = np.einsum("tij,mj->tmi", r1 - r0, places[held]) / (2.0 * step)
    velocity[:, held] += (p1 - p0)[:, None] / (2.0 * step)
