"""What answer.json says of a flower: what it is made of, what is hidden in it, how it was moved."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict

import numpy as np

from mphygs.capture.meshes import Part
from mphygs.synth.flower.true_motion import Settled, TrueMotion
from mphygs.synth.hidden import Hidden
from mphygs.synth.recipe import Recipe

# Stated for the true tracks, which have no noise: what a grid cannot be asked to be better than [m].
TRACK_SIGMA = 1e-4


def answer_of(
    recipe: Recipe,
    motion: TrueMotion,
    parts: Sequence[Part],
    densities: Mapping[str, float],
    settled: Settled,
    moved: Mapping[str, np.ndarray],
    differences: Mapping[str, Mapping[str, float]],
) -> dict[str, object]:
    """The truth, in the words of the other answers there are.

    parts, densities: of the shape that is published; moved: take -> vertices (T, V, 3) [m]; differences: take
    -> how far what is hidden moves them.
    """
    materials = recipe.materials
    return {
        "case": recipe.name,
        "hidden": [_public_name(h) for h in recipe.hidden] or ["none"],
        "effects": {h.name: {**h.values, **_settings(h, motion, settled)} for h in recipe.hidden},
        "faults": {},
        "rest": recipe.shape.rest,
        "gravity_published": recipe.shape.gravity.tolist(),
        "parts": {
            part.name: {
                "E": materials[part.name].youngs_modulus,
                "rho": densities[part.name],
                "nu": materials[part.name].poissons_ratio,
                "mass": densities[part.name] * part.volume,
                "volume_published": part.volume,
            }
            for part in parts
        },
        "object": {"shape": "flower", "species": recipe.name, "meshes": "truth"},
        "seed": recipe.seed,
        "sigma": TRACK_SIGMA,
        "motions": [[asdict(m) for m in take.motions] for take in recipe.takes],
        "differences": {"without_all": dict(differences)} if differences else {},
        "largest_motion_m": [
            float(max(np.linalg.norm(frame - v[0], axis=1).max() for frame in v)) for v in moved.values()
        ],
    }


def _settings(thing: Hidden, motion: TrueMotion, settled: Settled) -> dict[str, object]:
    """Of a hidden thing; places are those of the shape that is published."""
    settings = dict(thing.settings)
    if "place" in settings:
        place = np.array([settings["place"]], float)
        settings["place"] = motion.displaced(place, settled)[0].tolist()
    return settings


def _public_name(thing: Hidden) -> str:
    return f"unknown:{thing.name}" if thing.kind == "cause" else thing.name
