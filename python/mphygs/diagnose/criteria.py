"""Every number that decides in the loop, in one place, each with where it comes from."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Criteria:
    """What the loop goes by.

    tied: standard errors within which two models predict alike: less is no reason to choose (Vehtari, Gelman
    & Gabry, "Practical Bayesian model evaluation", 2017).
    price: of a number, in logarithms of the effective number of observations (1: BIC, Schwarz 1978); it
    counts half a unit of log-likelihood each.
    block_frames: frames whose errors hang together: one swing of what is slow.
    largest_model: effects in a model; three names that help where none is right are what chance brings.
    promising: share of the best one's promised drop from which a candidate is refitted, for a tangent
    promises within a factor of two or so of what a refit brings; refitted: at most so many.
    rival: share of the best one's worth from which a refit is brought to its end; finalists: at most so many.
    grid: mean square [noise's] that a coarse grid is granted of its own at least, where it decides nothing
    (two bodies discretised differently agree to 0.1 to 0.4 sigma); decided: candidates that the finer grid
    decides between, at most.
    near: misfit [sigma] up to which free runs decide between models: further off they are told apart under
    feedback, for free the materials make up for what is missing.
    share: of the motion, the error up to which tangents say what a model lacks: a swing that is off by half a
    radian answers as the right one would with a correlation of cos(1/2) = 0.88. Feedback is lowered as long
    as the model stays so near: the less there is, the longer what is missing has to show.
    negligible: misfit [sigma] up to which a model counts as adequate whatever the test of the floor says:
    held-out errors of 1.1 are the aim.
    negligible_rise: mean square [noise's] by which the misfit may rise when an effect is taken out again.
    """

    tied: float = 2.0
    price: float = 1.0
    block_frames: int = 8
    largest_model: int = 3
    promising: float = 0.4
    refitted: int = 12
    rival: float = 0.7
    finalists: int = 5
    grid: float = 0.05
    decided: int = 3
    near: float = 2.0
    share: float = 0.5
    negligible: float = 1.1
    negligible_rise: float = 0.01


CRITERIA = Criteria()
