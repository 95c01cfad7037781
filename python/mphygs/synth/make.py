"""From a recipe to a capture folder with its answer."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from mphygs.capture.format import Capture, Markers, save_capture
from mphygs.fit.spacings import default_spacing
from mphygs.simulate.settings import TRANSFERS
from mphygs.synth.bare_recordings import bare_capture, marker_places, moving_frames, whole_recording
from mphygs.synth.faults import seen_through, shifted
from mphygs.synth.finite_element import simulate_finite_element
from mphygs.synth.hidden import Hidden
from mphygs.synth.marker_noise import measure
from mphygs.synth.recipe import Recipe, Take, truth_spacing
from mphygs.synth.rod import simulate_rod
from mphygs.synth.shell import simulate_shell
from mphygs.synth.simulated_motion import SimulatedMotion
from mphygs.synth.synthetic_sensors import measured_sensors
from mphygs.synth.truth import simulate_truth

# Simulators that share no code with the model.
INDEPENDENT = {"finite-element": simulate_finite_element, "rod": simulate_rod, "shell": simulate_shell}


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
    places = marker_places(recipe)
    faults = {thing.name: thing.values for thing in recipe.of_kind("fault")}
    offset = faults["time_offset"]["offset"] if "time_offset" in faults else 0.0
    capture = bare_capture(recipe, folder, places)
    spacing = _spacing(recipe, capture)
    run = INDEPENDENT.get(recipe.simulator, simulate_truth)
    physics = tuple(h for h in recipe.hidden if h.kind != "fault")
    compared = bool(recipe.hidden and measure_signal)
    work = _Work(report, sum(moving_frames(t) for t in recipe.takes) * (2 if compared and physics else 1))
    recordings, differences, outliers, substeps = [], [], {}, []
    motions: dict[str, SimulatedMotion] = {}
    for number, (take, recording) in enumerate(zip(recipe.takes, capture.sequences, strict=True)):
        longer = whole_recording(recipe, take, places, extra=max(0, math.ceil(offset * take.fps)))
        text = f"{take.name}: {longer.frames} frames at {1e3 * spacing:.3g} mm"
        told = work.simulation(text, moving_frames(take))
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
                told = work.simulation(f"{take.name}: without what is hidden", moving_frames(take))
                same = whole_recording(recipe, take, places)
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


def _seen(
    motion: SimulatedMotion,
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
    motions: Mapping[str, SimulatedMotion],
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
