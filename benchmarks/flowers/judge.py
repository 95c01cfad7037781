"""How near a fit to a flower's pictures comes to the truth: materials by true part, segments, pictures."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from mphygs.capture.format import Capture, load_capture
from mphygs.capture.stages import StageFolder
from mphygs.fit.run import Run, load_run
from mphygs.fit.stage_particles import particles_of
from mphygs.scene.particles import closest_material
from mphygs.scene.soft_boundary import Particles

# A true part's mean logarithm counts as identifiable where its standard deviation is below this.
IDENTIFIABLE = 0.25
QUANTITIES = {"youngs_modulus": "E", "density": "rho"}


def judged(run: Path, capture: Path, answer: Mapping[str, object]) -> dict[str, object]:
    """Errors of pictures by range, of materials by true part where the model fits some, what its volume came
    out as over its true one, and the adjusted Rand index of the segments, as they are and with those of one
    true part made one."""
    state = load_run(run)
    truth = load_capture(capture / "truth")
    particles, label, true_part = _labels(state.stages, truth)
    names = [part.name for part in truth.parts]
    parts = json.loads((capture / "answer.json").read_text())["parts"]
    sequences = answer["sequences"]
    return {
        "fit": sequences["frog"]["fit"],
        "in": sequences["frog"]["predict"],
        "cross": sequences["turned"]["predict"],
        "materials": materials(state, label, true_part, names, parts) if state.belief.free else {},
        "volume_ratio": {
            part.name: float((true_part == k).sum() * particles.spacing**3 / part.volume)
            for k, part in enumerate(truth.parts)
        },
        **_agreement(label, true_part),
        "fit_stages": {stage.name: stage.seconds for stage in state.history},
    }


def segments(stages: Path, capture: Path) -> dict[str, float]:
    """How many segments a folder of stages has, and their adjusted Rand index, as `judged` tells it."""
    _, label, true_part = _labels(stages, load_capture(capture / "truth"))
    return _agreement(label, true_part)


def _labels(stages: Path, truth: Capture) -> tuple[Particles, np.ndarray, np.ndarray]:
    """The particles, and of those inside, (N,) each, the segment and the true part."""
    particles = particles_of(stages, len(list(StageFolder(stages).parts.glob("*.ply"))))
    true_part = closest_material(truth.parts, particles.position[particles.inside]).part
    return particles, particles.label[particles.inside], true_part


def _agreement(label: np.ndarray, true_part: np.ndarray) -> dict[str, float]:
    return {
        "segments": int(label.max()) + 1,
        "adjusted_rand_index": adjusted_rand_index(label, true_part),
        "adjusted_rand_index_merged": adjusted_rand_index(_merged(label, true_part), true_part),
    }


def materials(
    run: Run,
    label: np.ndarray,
    true_part: np.ndarray,
    names: list[str],
    truth: Mapping[str, Mapping[str, float]],
) -> dict[str, dict[str, float | bool]]:
    """Error of the mean logarithm over each true part, with its standard deviation by the fit."""
    belief = run.belief
    column = {p.key: k for k, p in enumerate(belief.free)}
    if len(belief.parts) == 1:
        label = np.zeros_like(label)
    found = {}
    for number, name in enumerate(names):
        share = np.bincount(label[true_part == number], minlength=len(belief.parts)).astype(float)
        share /= max(share.sum(), 1.0)
        for quantity, symbol in QUANTITIES.items():
            keys = [f"{part}.{quantity}" for part in belief.parts]
            mean = sum(w * math.log(belief[key].value) for w, key in zip(share, keys, strict=True))
            weight = np.zeros(len(column))
            for w, key in zip(share, keys, strict=True):
                if key in column:
                    weight[column[key]] = w
            std = float(np.sqrt(max(weight @ run.covariance @ weight, 0.0)))
            found[f"{name}.{symbol}"] = {
                "error": mean - math.log(truth[name][symbol]),
                "std": std,
                "identifiable": std < IDENTIFIABLE,
            }
    return found


def _merged(label: np.ndarray, true_part: np.ndarray) -> np.ndarray:
    """Labels with segments that lie mostly in one true part made one: what oversegmentation costs is gone."""
    table = np.zeros((label.max() + 1, true_part.max() + 1))
    np.add.at(table, (label, true_part), 1.0)
    return table.argmax(1)[label]


def adjusted_rand_index(first: np.ndarray, second: np.ndarray) -> float:
    """Agreement of two labellings (N,), 1 for the same, about 0 for chance (Hubert and Arabie 1985)."""
    _, a = np.unique(first, return_inverse=True)
    _, b = np.unique(second, return_inverse=True)
    table = np.zeros((a.max() + 1, b.max() + 1))
    np.add.at(table, (a.ravel(), b.ravel()), 1.0)

    def pairs(counts: np.ndarray) -> float:
        return float((counts * (counts - 1.0)).sum() / 2.0)

    together, rows, columns = pairs(table), pairs(table.sum(1)), pairs(table.sum(0))
    chance = rows * columns / max(pairs(np.array([float(len(a))])), 1.0)
    best = 0.5 * (rows + columns)
    return 1.0 if best == chance else (together - chance) / (best - chance)
