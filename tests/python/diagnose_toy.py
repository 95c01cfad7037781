"""A small linear problem with smooth candidate effects, for the tests of diagnosis."""

from __future__ import annotations

import numpy as np

from mphygs.compare.blocks import Blocks, part_time_blocks
from mphygs.diagnose.score import score_candidates
from mphygs.diagnose.score_table import Candidate, ScoreTable

FRAMES, MARKERS = 40, 6
COUNT = FRAMES * MARKERS * 3


def candidate(name: str, tangent: np.ndarray, *, bounded: bool = False) -> Candidate:
    tangent = tangent.reshape(len(tangent), -1)
    columns = tangent.shape[1]
    return Candidate(
        name=name, tangent=tangent, lower_bounded=np.full(columns, bounded), null=np.zeros(columns)
    )


def smooth_tangents(generator: np.random.Generator, count: int) -> np.ndarray:
    """(FRAMES, MARKERS, 3, count) responses that are smooth over frames, of length about 30."""
    time = np.linspace(0.0, 1.0, FRAMES)[:, None]
    courses = np.sin(np.pi * time * generator.uniform(0.5, 4.0, count) + generator.uniform(0.0, 6.0, count))
    shapes = generator.normal(size=(MARKERS, 3, count))
    return courses[:, None, None, :] * shapes * 1.5


def toy(generator: np.random.Generator, count: int = 6) -> tuple[np.ndarray, list[Candidate]]:
    tangents = smooth_tangents(generator, count + 3).reshape(COUNT, -1)
    candidates = [candidate(f"e{k}", tangents[:, k], bounded=k % 2 == 0) for k in range(count)]
    candidates.append(candidate("vector", tangents[:, [0, 1, 2]] + generator.normal(size=(COUNT, 3)) * 0.5))
    return tangents[:, count:], candidates


def table_of(
    residual: np.ndarray, jacobian: np.ndarray, candidates: list[Candidate], *, sigma_known: bool = True
) -> ScoreTable:
    return score_candidates(
        residual, jacobian, candidates, generator=np.random.default_rng(0), sigma_known=sigma_known
    )


def grid_blocks(length: int = 10) -> Blocks:
    frame, marker, _ = np.nonzero(np.ones((FRAMES, MARKERS, 3)))
    return part_time_blocks((marker >= 3).astype(int), frame, names=("left", "right"), length=length)
