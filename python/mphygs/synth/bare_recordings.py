"""Recordings of a recipe before anything was measured: what holds and drives the object, and how long."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from mphygs.capture.format import Capture, Hold, Known, Load, Markers
from mphygs.capture.motions import hold_poses, ramp
from mphygs.capture.record import Sequence as Recording
from mphygs.synth.drive import arriving, stated
from mphygs.synth.marker_noise import place_crosses, place_markers
from mphygs.synth.recipe import Recipe, Take
from mphygs.synth.shape import Shape
from mphygs.synth.synthetic_sensors import empty_sensors

# Of the size of an object: how far about its tip it is pulled.
TIP = 0.12


def marker_places(recipe: Recipe) -> np.ndarray:
    """(M, 3) [m]: crosses along cables, else inside the object and on it."""
    shape = recipe.shape
    if shape.lines:
        boxes = [shape.hold] if shape.far_hold is None else [shape.hold, shape.far_hold]
        return place_crosses([line for line in shape.lines if shape.parts[line.part].shape == "rod"],
                             np.array(boxes), recipe.marker_count)  # fmt: skip
    return place_markers(shape.parts, recipe.marker_count, np.random.default_rng([recipe.seed, 2]))


def moving_frames(take: Take) -> int:
    """Number of frames after the release."""
    return take.cut + take.frames - 1 - (take.release or 0)


def bare_capture(recipe: Recipe, folder: Path, places: np.ndarray) -> Capture:
    """The capture before anything was recorded: with what is known of it."""
    shape = recipe.shape
    ratios = {name: material.poissons_ratio for name, material in recipe.materials.items()}
    same = len(set(ratios.values())) == 1
    stated = {"first-density": shape.part_names[:1], "densities": shape.part_names}.get(recipe.known, ())
    known = Known(
        density={name: recipe.materials[name].density for name in stated},
        poissons_ratio=next(iter(ratios.values())) if same else ratios,
        mass=recipe.mass if recipe.known == "mass" else None,
    )
    recordings = tuple(_shown(recipe, take, places) for take in recipe.takes)
    return Capture(recipe.name, folder, shape.gravity, shape.parts, shape.rest, known, recordings)


def whole_recording(recipe: Recipe, take: Take, places: np.ndarray, extra: int = 0) -> Recording:
    """One take without measurements, `extra` frames longer, with what the capture does not show of it."""
    whole = replace(take, frames=take.cut + take.frames)
    recording = bare_recording(recipe, whole, places, extra)
    acting = tuple(arriving(take.drive, a, take.fps) for a in recording.actuators)
    return replace(recording, loads=_pulling(recipe.shape, take), actuators=acting)


def _pulling(shape: Shape, take: Take) -> tuple[Load, ...]:
    """What pulls the object aside before frame 0: in steps, a frame each, and whole for the last fifth."""
    if take.pull is None:
        return ()
    corners = np.concatenate([part.bounds for part in shape.parts])
    reach = TIP * np.linalg.norm(np.ptp(corners, axis=0))
    box = shape.tip + np.array([[-reach], [reach]])
    grown = ramp((np.arange(take.cut) + 0.5) / (0.8 * take.cut))
    return tuple(Load(box, share * np.array(take.pull), k, k + 1) for k, share in enumerate(grown))


def _shown(recipe: Recipe, take: Take, places: np.ndarray) -> Recording:
    """What the capture shows of a take, without measurements: the rest of it, if it begins late."""
    recording = bare_recording(recipe, replace(take, frames=take.cut + take.frames), places)
    if not take.cut:
        return recording
    held = tuple(
        hold if hold.is_fixed else Hold(hold.box, hold.position[take.cut :], hold.quaternion[take.cut :])
        for hold in recording.held
    )
    markers = replace(recording.markers, position=recording.markers.position[take.cut :])
    sensors = tuple(replace(one, value=one.value[take.cut :]) for one in recording.sensors)
    return replace(recording, frames=take.frames, held=held, markers=markers, release=None, sensors=sensors)


def bare_recording(recipe: Recipe, take: Take, places: np.ndarray, extra: int = 0) -> Recording:
    """One take without measurements, `extra` frames longer."""
    frames = take.frames + extra
    shape = recipe.shape
    driven = ()
    if take.drive is not None:
        stiffness = {name: material.youngs_modulus for name, material in recipe.materials.items()}
        times = np.maximum(np.arange(frames) - (take.release or 0), 0) / take.fps
        number = [t.name for t in recipe.takes].index(take.name)
        driven = (stated(take.drive, shape, stiffness, times, number),)
    unseen = Markers(np.full((frames, len(places), 3), np.nan), places, recipe.noise.sigma)
    return Recording(
        take.name,
        take.fps,
        frames,
        fit=take.fit,
        predict=take.predict,
        held=_holds(shape, take, frames),
        release=take.release,
        markers=unseen,
        sensors=empty_sensors(recipe.sensors, shape, frames),
        actuators=driven,
    )


def _holds(shape: Shape, take: Take, frames: int) -> tuple[Hold, ...]:
    """What holds the object in a take, the first hold first."""
    given = [(shape.hold, shape.pivot, take.motions)]
    if shape.far_hold is not None:
        given.append((shape.far_hold, shape.far_pivot, take.far_motions))
    times = np.arange(frames) / take.fps
    return tuple(
        Hold(box, *hold_poses(motions, times, pivot)) if motions else Hold(box)
        for box, pivot, motions in given
    )
