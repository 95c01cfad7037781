"""The grouping loss: segments that look alike are made of like material.

L_g = L_s + w_v L_v of the paper (method, section 3) over particles, which hold one material a segment, is a
quadratic form in the segments' logarithms; its terms become priors on pairs of segments, and on each
segment's distance from the mean. The paper gives no scale for L_g beside a likelihood: here two segments
that look the same are as alike as LIKE_STD says, and segments scatter about the mean by SPREAD_STD.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mphygs.model.belief import Belief, LikenessPrior
from mphygs.scene.grouping import NEIGHBOURS, likeness
from mphygs.scene.soft_boundary import Particles

LIKE_STD, SPREAD_STD = 0.3, 1.5
# A prior wider than this says nothing.
WIDEST_STD = 6.0
# Particles that the neighbourhoods in appearance are taken over, and dimensions of it.
_SAMPLE, _DIMENSIONS = 4000, 16
QUANTITIES = ("youngs_modulus", "density")


def alikeness(particles: Particles, count: int, *, seed: int = 0) -> np.ndarray:
    """(S, S) how much segments look like one another: w_ij of L_s summed over particles, symmetric.

    Each particle's 20 nearest in appearance share one weight; of two segments that look exactly alike each
    has half of its weight in the other. Rows are of segments, relative to their number of particles.
    """
    number = np.flatnonzero(particles.inside)
    if len(number) > _SAMPLE:
        number = np.sort(np.random.default_rng(seed).choice(number, _SAMPLE, replace=False))
    label, look = particles.label[number], _normalised(particles.appearance[number])
    alike = likeness(look, neighbours=min(NEIGHBOURS, len(number) - 1))
    index, weight = alike.index.numpy(), alike.weight.numpy()
    total = np.zeros((count, count))
    np.add.at(total, (np.repeat(label, index.shape[1]), label[index].ravel()), weight.ravel())
    mine = np.maximum(np.bincount(label, minlength=count), 1)
    shares = total / mine[:, None]
    return 0.5 * (shares + shares.T)


def _normalised(appearance: np.ndarray) -> np.ndarray:
    """Appearance with rows of length one, along its principal directions."""
    length = np.linalg.norm(appearance, axis=1, keepdims=True)
    unit = appearance / np.maximum(length, 1e-12)
    if unit.shape[1] <= _DIMENSIONS:
        return unit
    centred = unit - unit.mean(0)
    _, _, directions = np.linalg.svd(centred[:: max(1, len(centred) // 1000)], full_matrices=False)
    return centred @ directions[:_DIMENSIONS].T


def with_grouping(belief: Belief, parts: Sequence[str], particles: Particles) -> Belief:
    """The belief with the grouping loss on Young's modulus and density of the segments.

    parts: names in the order of the particles' labels. Segments of known material are left out.
    """
    alike = alikeness(particles, len(parts))
    label = particles.label[particles.inside]
    share = np.bincount(label, minlength=len(parts)) / len(label)
    likenesses = []
    for quantity in QUANTITIES:
        free = [k for k, part in enumerate(parts) if belief[f"{part}.{quantity}"].free]
        if len(free) < 2:
            continue
        keys = {k: f"{parts[k]}.{quantity}" for k in free}
        for place, one in enumerate(free):
            for other in free[place + 1 :]:
                # half of the weight in the other: as like as can be
                std = LIKE_STD / np.sqrt(max(2.0 * alike[one, other], 1e-12))
                if std < WIDEST_STD:
                    likenesses.append(LikenessPrior((keys[one], keys[other]), (1.0, -1.0), float(std)))
        weight = np.array([share[k] for k in free]) + 1e-6
        weight /= weight.sum()
        for place, one in enumerate(free):
            std = SPREAD_STD / np.sqrt(len(free) * weight[place])
            about = {k: -w for k, w in zip(free, weight, strict=True)}
            about[one] += 1.0
            coefficients = tuple(float(about[k]) for k in free)
            likenesses.append(LikenessPrior(tuple(keys.values()), coefficients, float(std)))
    return replace(belief, likenesses=(*belief.likenesses, *likenesses))
