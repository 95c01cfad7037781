"""How grown flowers look, place by place, and what they are made of there: examples to learn from."""

from __future__ import annotations

import numpy as np

from mphygs.baselines.prior import Examples, shown_of
from mphygs.synth.flower.catalogue import SPECIES
from mphygs.synth.flower.drawing import Painter
from mphygs.synth.flower.growth import grow

# Flowers of each species, and points of each flower.
SEEDS, POINTS = 4, 1200
# Seeds of flowers that are made to be looked at are small numbers: these are others.
FIRST = 90_000


def flower_looks(seed: int) -> Examples:
    """Places of flowers of every species. seed: which flowers, and which of their points."""
    generator = np.random.default_rng([seed, 2])
    shown, material = [], []
    for species in SPECIES.values():
        for k in range(SEEDS):
            number = FIRST + SEEDS * seed + k
            flower = grow(species, number)
            points, colour, part = Painter(flower, number).at_vertices()
            some = np.sort(generator.permutation(len(points))[:POINTS])
            known = [flower.materials[name] for name in species.part_names]
            numbers = np.array([[np.log10(m.youngs_modulus), np.log10(m.density)] for m in known])
            shown.append(shown_of(points[some], colour[some], np.array([0.0, 0.0, 1.0])))
            material.append(numbers[part[some]])
    return Examples(np.concatenate(shown), np.concatenate(material))
