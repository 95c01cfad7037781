"""What the grid's own error excuses, and what it does not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bar_capture import bar_belief, bar_capture
from extend_example import recorded
from mphygs.compare.assess import Assessment, assess, grid_shift, in_words
from mphygs.compare.noise import NoiseModel, Observation
from mphygs.fit.experiment import Experiment
from mphygs.simulate.prediction import Settings

SPACING, FRAMES, SPLIT = 0.01, 24, 12


def assessed(fit: tuple[float, float], predict: tuple[float, float]) -> Assessment:
    """Misfit beyond noise and the grid's share [sigma] of the fitted and of the unseen frames.

    The two have nothing to do with each other but their size.
    """
    capture = bar_capture(frames=FRAMES, fps=100.0, fit=(0, SPLIT))
    truth = bar_belief(capture, youngs_modulus=6e4, free=())
    experiment = Experiment.of(recorded(capture, truth, SPACING), Settings(SPACING, workers=1))
    name, item = next(iter(experiment.compare(truth, SPACING).items()))
    draw, shape = np.random.default_rng(3), item.observation.position.shape
    sigma = item.observation.sigma
    levels = np.where(np.arange(FRAMES)[:, None] < SPLIT, fit, predict)
    size = levels[..., None, None] * sigma
    signs = draw.choice([-1.0, 1.0], (2, *shape))
    noise = sigma * draw.standard_normal(shape)
    wrong = replace(
        item,
        predicted=item.observation.position - noise - size[:, 0] * signs[0],
        refinement=size[:, 1] * signs[1],
        fit=(0, SPLIT),
        predict=(SPLIT, FRAMES),
    )
    return experiment.assess({name: wrong})


def test_nothing_is_adequate_that_the_test_of_the_floor_rejects() -> None:
    # What a refinement does not show as it stands in the misfit excuses nothing, however large it is.
    for share in (2.4, 1.0, 0.0):
        found = assessed((2.0, share), (3.0, share))
        assert not found.adequate and found.p_value < 1e-6


def test_shares_add_to_the_misfit_in_squares() -> None:
    found = assessed((2.0, 1.0), (2.0, 1.0))
    shares = [found.budget[name] / found.budget["noise"] for name in ("noise", "discretisation", "physics")]
    assert shares == pytest.approx([1.0, 1.0, np.sqrt(3.0)], rel=0.05)


def test_metres_are_those_of_each_sequence_whatever_the_noise_of_others() -> None:
    """A clean sequence is off by two sigma of its own, one beside it of five times the noise by none."""
    capture = bar_capture(frames=FRAMES, fps=100.0, fit=(0, SPLIT))
    truth = bar_belief(capture, youngs_modulus=6e4, free=())
    experiment = Experiment.of(recorded(capture, truth, SPACING), Settings(SPACING, workers=1))
    item = next(iter(experiment.compare(truth, SPACING).values()))
    sigma, draw = item.observation.sigma, np.random.default_rng(3)
    items = {}
    for name, noise, off in (("clean", sigma, 2.0 * sigma), ("noisy", 5.0 * sigma, 0.0)):
        position = item.observation.position
        wrong = position - noise * draw.standard_normal(position.shape) - off
        observation = Observation(position, NoiseModel.white(noise, "stated"), item.observation.weight)
        items[name] = replace(
            item, observation=observation, predicted=wrong, fit=(0, SPLIT), predict=(SPLIT, FRAMES)
        )
    names = tuple(p.name for p in capture.parts)
    found = assess(items, names, part_centers=np.zeros((len(names), 3)))
    assert {w["sequence"] for w in found.when} == {"clean"}
    assert [w["rms"] for w in found.when] == pytest.approx(
        [2.0 * sigma * np.sqrt(3.0)] * len(found.when), rel=0.15
    )
    assert found.budget["noise"] == pytest.approx(np.sqrt(3.0 * 13.0) * sigma)
    assert found.budget["physics"] == pytest.approx(np.sqrt(3.0 * 2.0) * sigma, rel=0.2)
    assert found.budget["physics"] == pytest.approx(found.where[0]["rms"])


@pytest.mark.parametrize("slope", [1.0, 3.0])
def test_how_far_the_grid_moves_a_number_is_what_its_own_tangents_say(slope: float) -> None:
    """A refinement that moves every marker as 0.2 of a coordinate would, and a prior as sure as the data."""
    capture = bar_capture(frames=FRAMES, fps=100.0, fit=(0, SPLIT))
    truth = bar_belief(capture, youngs_modulus=6e4, free=("part0.youngs_modulus",))
    experiment = Experiment.of(recorded(capture, truth, SPACING), Settings(SPACING, workers=1))
    name, item = next(iter(experiment.compare(truth, SPACING).items()))
    item = replace(item, jacobian=slope * item.jacobian, fit=(0, SPLIT), predict=(SPLIT, FRAMES))
    assert grid_shift({name: item}, np.zeros((1, 1))) is None
    item = replace(item, refinement=0.2 * item.jacobian[..., 0])
    assert grid_shift({name: item}, np.zeros((1, 1))) == pytest.approx([0.2])
    rows = item.jacobian[:SPLIT][item.observation.observed[:SPLIT]] / item.observation.sigma
    assert grid_shift({name: item}, np.array([[np.sum(rows**2)]])) == pytest.approx([0.1], rel=0.02)


@pytest.mark.parametrize(
    ("adequate", "p_value", "words"),
    [
        (True, 0.3, "no more than noise"),
        (False, 1e-9, "more than noise"),
        # Below the practical floor, or covered by the grid's share: not to be called noise.
        (True, 1e-9, "more than noise alone, and no more than what a grid has of its own"),
    ],
)
def test_a_misfit_that_is_excused_is_not_called_noise(adequate: bool, p_value: float, words: str) -> None:
    assert in_words(adequate, p_value) == words
