"""From a recipe to a capture folder with its answer."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from mphygs.capture.format import Capture, Hold, Known, Load, Markers, save_capture
from mphygs.capture.motions import hold_poses, ramp
from mphygs.capture.record import Sequence as Recording
from mphygs.fit.spacings import default_spacing
from mphygs.simulate.settings import TRANSFERS
from mphygs.synth.drive import arriving, stated
from mphygs.synth.faults import seen_through, shifted
from mphygs.synth.finite_element import simulate_finite_element
from mphygs.synth.hidden import Hidden
from mphygs.synth.marker_noise import measure, place_crosses, place_markers
from mphygs.synth.motion import Motion
from mphygs.synth.recipe import Recipe, Take, truth_spacing
from mphygs.synth.rod import simulate_rod
from mphygs.synth.shape import Shape
from mphygs.synth.shell import simulate_shell
from mphygs.synth.synthetic_sensors import empty_sensors, measured_sensors
from mphygs.synth.truth import simulate_truth

# Simulators that share no code with the model.
INDEPENDENT = {"finite-element": simulate_finite_element, "rod": simulate_rod, "shell": simulate_shell}
# Of the size of an object: how far about its tip it is pulled.
TIP = 0.12


@dataclass(frozen=True, eq=False)
class Made:
    """A capture written to `folder`, and what its answer.json says."""

    folder: Path
    answer: dict[str, object]


def make_capture(
    recipe: Recipe,
    folder: str | Path,
    *,
    measure_signal: bool = True,
    report: Callable[[float, str], None] | None = None,
) -> Made:
    """Simulate a recipe and write the capture and its answer.json to `folder`.

    measure_signal: also simulate without what is hidden, to state its size over the noise; report: told,
    frame by frame, the share of the work that is done and what is simulated.
    Raises ValueError for a recipe that contradicts itself, RuntimeError where it cannot be simulated.
    """
    folder = Path(folder)
    places = _marker_places(recipe)
    faults = {thing.name: thing.values for thing in recipe.of_kind("fault")}
    offset = faults["time_offset"]["offset"] if "time_offset" in faults else 0.0
    capture = _bare_capture(recipe, folder, places)
    spacing = _spacing(recipe, capture)
    run = INDEPENDENT.get(recipe.simulator, simulate_truth)
    physics = tuple(h for h in recipe.hidden if h.kind != "fault")
    compared = bool(recipe.hidden and measure_signal)
    work = _Work(report, sum(_moving(t) for t in recipe.takes) * (2 if compared and physics else 1))
    recordings, differences, outliers, substeps = [], [], {}, []
    motions: dict[str, Motion] = {}
    for number, (take, recording) in enumerate(zip(recipe.takes, capture.sequences, strict=True)):
        longer = _whole(recipe, take, places, extra=max(0, math.ceil(offset * take.fps)))
        text = f"{take.name}: {longer.frames} frames at {1e3 * spacing:.3g} mm"
        told = work.simulation(text, _moving(take))
        motions[take.name] = motion = run(capture, longer, recipe, physics, spacing, told).after(take.cut)
        substeps.append(motion.substeps)
        seen, lost = _seen(motion, take, faults, offset, np.random.default_rng([recipe.seed, 3, number]))
        if len(lost):
            outliers[take.name] = lost.tolist()
        # Noise of its own seed: the same with and without a fault that draws numbers.
        tracks = measure(seen, recipe.noise, np.random.default_rng([recipe.seed, 4, number]))
        draw = np.random.default_rng([recipe.seed, 5, number])
        sensors = measured_sensors(recording, motion.readings, offset, draw)
        markers = Markers(tracks, places, recipe.noise.sigma)
        recordings.append(replace(recording, markers=markers, sensors=sensors))
        if compared:
            plain = motion.position[: take.frames]
            if physics:
                told = work.simulation(f"{take.name}: without what is hidden", _moving(take))
                same = _whole(recipe, take, places)
                plain = run(capture, same, recipe, (), spacing, told).after(take.cut).position
            differences.append(_difference(seen, plain, take, recipe.noise.sigma))
    capture = replace(capture, sequences=tuple(recordings))
    save_capture(capture, folder)
    answer = _answer(recipe, differences, outliers, motions)
    answer["simulation"] = {
        "simulator": recipe.simulator,
        "shares_code_with_the_model": recipe.simulator not in INDEPENDENT,
        "spacing": spacing,
        "substeps": substeps,
    }
    (folder / "answer.json").write_text(
        json.dumps(answer, indent=1, allow_nan=False) + "\n", encoding="utf-8"
    )
    return Made(folder, answer)


def _spacing(recipe: Recipe, capture: Capture) -> float:
    """Of the truth's grid or nodes [m]. What is thin is of rods and sheets in the core's grids, by volume in
    those that are none."""
    if recipe.simulator in TRANSFERS and any(part.shape != "solid" for part in capture.parts):
        return recipe.spacing_share * default_spacing(capture)
    return truth_spacing(recipe.spacing_share, sum(part.volume for part in capture.parts))


def _marker_places(recipe: Recipe) -> np.ndarray:
    """(M, 3) [m]: crosses along cables, else inside the object and on it."""
    shape = recipe.shape
    if shape.lines:
        boxes = [shape.hold] if shape.far_hold is None else [shape.hold, shape.far_hold]
        return place_crosses([line for line in shape.lines if shape.parts[line.part].shape == "rod"],
                             np.array(boxes), recipe.marker_count)  # fmt: skip
    return place_markers(shape.parts, recipe.marker_count, np.random.default_rng([recipe.seed, 2]))


class _Work:
    """Says through `report`, where there is one, how much of so many frames is simulated."""

    def __init__(self, report: Callable[[float, str], None] | None, frames: int) -> None:
        self._report, self._frames, self._end = report, frames, 0

    def simulation(self, text: str, frames: int) -> Callable[[int], bool]:
        """Begin a simulation; what is returned is called with the number of its frames that are done."""
        begin = self._end
        self._end += frames

        def tell(done: int) -> bool:
            if self._report:
                self._report((begin + min(done, frames)) / self._frames, text)
            return True

        tell(0)
        return tell


def _moving(take: Take) -> int:
    """Number of frames after the release."""
    return take.cut + take.frames - 1 - (take.release or 0)


def _bare_capture(recipe: Recipe, folder: Path, places: np.ndarray) -> Capture:
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


def _whole(recipe: Recipe, take: Take, places: np.ndarray, extra: int = 0) -> Recording:
    """One take without measurements, `extra` frames longer, with what the capture does not show of it."""
    whole = replace(take, frames=take.cut + take.frames)
    recording = _recording(recipe, whole, places, extra)
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
    recording = _recording(recipe, replace(take, frames=take.cut + take.frames), places)
    if not take.cut:
        return recording
    held = tuple(
        hold if hold.is_fixed else Hold(hold.box, hold.position[take.cut :], hold.quaternion[take.cut :])
        for hold in recording.held
    )
    markers = replace(recording.markers, position=recording.markers.position[take.cut :])
    sensors = tuple(replace(one, value=one.value[take.cut :]) for one in recording.sensors)
    return replace(
        recording, frames=take.frames, held=held, markers=markers, release=None, sensors=sensors
    )


def _recording(recipe: Recipe, take: Take, places: np.ndarray, extra: int = 0) -> Recording:
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


def _seen(
    motion: Motion,
    take: Take,
    faults: Mapping[str, Mapping[str, float]],
    offset: float,
    generator: np.random.Generator,
) -> tuple[np.ndarray, np.ndarray]:
    """What a noiseless measurement shows (T, M, 3) [m], and the markers that lost the object."""
    times = np.arange(take.frames) / take.fps
    position = motion.position[: take.frames]
    if offset:
        recorded = np.arange(len(motion.position)) / take.fps
        position = shifted(recorded, motion.position, motion.velocity, times + offset)
    return seen_through(position, times, faults, motion.movable, generator)


def _difference(shown: np.ndarray, plain: np.ndarray, take: Take, sigma: float) -> dict[str, float]:
    """How far what is shown lies from the motion without what is hidden."""
    distance = np.linalg.norm(shown - plain, axis=2)

    def rms(frames: tuple[int, int]) -> float | None:
        window = distance[slice(*frames)]
        return float(np.sqrt(np.mean(window**2))) / sigma if window.size else None

    return {
        "rms_difference_m": float(np.sqrt(np.mean(distance**2))),
        "signal_over_noise": rms((0, len(distance))),
        "signal_over_noise_fit": rms(take.fit),
        "signal_over_noise_predict": rms(take.predict),
        "largest_difference_m": float(distance.max()),
    }


def _answer(
    recipe: Recipe,
    differences: Sequence[dict],
    outliers: Mapping[str, list[int]],
    motions: Mapping[str, Motion],
) -> dict[str, object]:
    """The truth, in the words of the other answers there are."""
    volume = {part.name: part.volume for part in recipe.shape.parts}
    parts = {
        name: {
            "E": m.youngs_modulus, "rho": m.density, "nu": m.poissons_ratio, "mass": m.density * volume[name],
            "volume_published": volume[name],
        }
        for name, m in recipe.materials.items()
    }  # fmt: skip
    faults: dict[str, object] = {h.name: dict(h.values) for h in recipe.of_kind("fault")}
    if outliers:
        faults["marker_outliers"]["markers"] = outliers
    rest = {take.name: motions[take.name].position[: take.frames] for take in recipe.takes}
    return {
        "case": recipe.name,
        "hidden": [_public_name(h) for h in recipe.hidden] or ["none"],
        "effects": {h.name: {**h.values, **h.settings} for h in recipe.hidden if h.kind != "fault"},
        "faults": faults,
        "rest": recipe.shape.rest,
        "gravity_published": recipe.shape.gravity.tolist(),
        "parts": parts,
        "object": {"shape": recipe.shape.name},
        "sigma": recipe.noise.sigma,
        "noise": asdict(recipe.noise),
        "sensors": dict(recipe.sensors),
        "seed": recipe.seed,
        "markers": recipe.marker_count,
        "drives": [None if take.drive is None else asdict(take.drive) for take in recipe.takes],
        "motions": [[asdict(m) for m in take.motions] for take in recipe.takes],
        "far_motions": [[asdict(m) for m in take.far_motions] for take in recipe.takes],
        "signal_over_noise": differences[0]["signal_over_noise"] if differences else None,
        "rms_difference_m": differences[0]["rms_difference_m"] if differences else None,
        "differences": {"without_all": list(differences)} if differences else {},
        "largest_motion_m": [float(np.linalg.norm(p - p[0], axis=2).max()) for p in rest.values()],
    }


def _public_name(thing: Hidden) -> str:
    return f"unknown:{thing.name}" if thing.kind == "cause" else thing.name
