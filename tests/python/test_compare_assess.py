"""What the grid's own error excuses, and what it does not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bar_capture import bar_belief, bar_capture
from extend_example import recorded
from mphygs.compare.assess import (
    BUDGET_FLOOR,
    Assessment,
    assess,
    in_words,
    ratios,
    ratios_at_zero_spacing,
    stays,
)
from mphygs.compare.compared import whiten_all
from mphygs.compare.grid_share import grid_shift
from mphygs.compare.noise import NoiseModel, Observation
from mphygs.fit.experiment import Experiment
from mphygs.simulate.prediction import Settings

SPACING, FRAMES, SPLIT = 0.01, 24, 12


def assessed(
    fit: tuple[float, float],
    predict: tuple[float, float],
    *,
    staying: bool = False,
    alike: bool = False,
) -> Assessment:
    """Misfit beyond noise and the grid's share [sigma] of the fitted and of the unseen frames.

    The two have nothing to do with each other but their size, or are alike. staying: whether a finer grid
    left the misfit.
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
        refinement=-size[:, 1] * signs[0] if alike else size[:, 1] * signs[1],
        fit=(0, SPLIT),
        predict=(SPLIT, FRAMES),
        stays=staying,
    )
    return experiment.assess({name: wrong})


def test_what_the_grid_moves_as_much_is_its_own() -> None:
    assert assessed((2.0, 2.4), (3.0, 3.3)).adequate
    assert not assessed((2.0, 1.0), (3.0, 1.0)).adequate
    assert not assessed((2.0, 0.0), (3.0, 0.0)).adequate


@pytest.mark.parametrize(
    ("beyond", "share", "by"),
    [
        (0.0, 0.0, "noise"),
        (0.0, 0.5, "noise"),
        (3.0, 3.3, "grid"),
        (3.0, 1.0, None),
    ],
)
def test_verdict_and_p_value_agree(beyond: float, share: float, by: str | None) -> None:
    found = assessed((beyond, share), (beyond, share))
    assert (found.by, found.adequate) == (by, by is not None)
    assert (found.p_value >= 0.01) is (by in ("noise", "grid"))
    assert found.grid == pytest.approx(share, rel=0.01, abs=1e-12)
    if by == "noise":
        # That of the test of the floor, which is uniform over nulls: a share that was measured adds nothing.
        assert found.p_value == found.floor.p_value < 1.0


def test_fitted_frames_do_not_pay_for_unseen_ones() -> None:
    found = assessed((1.5, 3.0), (1.5, 0.2))
    # as a whole the grid's share covers the misfit
    assert np.hypot(1.0, found.budget["physics"] / found.budget["noise"]) < BUDGET_FLOOR
    assert not found.adequate


def rated(fit: float, predict: float, count: int = 2000) -> Assessment:
    """Misfits [sigma] of fitted and unseen frames."""
    ratio, rows = {"a": {"fit": fit, "predict": predict}}, {"a": {"fit": count, "predict": count}}
    return Assessment(False, 0.0, ratio, None, [], [], {}, rows=rows)


@pytest.mark.parametrize(
    ("coarse", "fine", "left"),
    [
        # a misfit that falls with the spacing, at first order or faster, is the grid's
        ((1.30, 1.60), (1.19, 1.39), False),
        ((1.30, 1.60), (1.10, 1.20), False),
        # one that does not fall is physics, whether or not a finer grid finds more of it
        ((1.30, 1.60), (1.29, 1.58), True),
        ((1.30, 1.60), (1.35, 1.70), True),
        # fitted frames at the noise: what unseen ones show may be the errors of the numbers
        ((1.00, 1.60), (1.01, 1.60), False),
        # the grid moves unseen frames, and has to be asked again
        ((1.30, 1.60), (1.29, 1.40), False),
        # no reason to doubt the physics
        ((1.09, 1.08), (1.09, 1.08), False),
    ],
)
def test_what_a_finer_grid_leaves_is_not_the_grids(
    coarse: tuple[float, float], fine: tuple[float, float], left: bool
) -> None:
    assert stays(rated(*coarse), rated(*fine), 1.3) is left


def test_few_rows_do_not_tell_physics_from_noise() -> None:
    assert stays(rated(1.1, 1.6), rated(1.1, 1.6), 1.3)
    assert not stays(rated(1.1, 1.6, 60), rated(1.1, 1.6, 60), 1.3)
    # nor do many, where the noise's own scale was measured in a few frames
    fine = replace(rated(1.1, 1.6), noise_degrees=40.0)
    assert not stays(rated(1.1, 1.6), fine, 1.3)


@pytest.mark.parametrize("staying", [False, True])
def test_no_direction_of_the_grid_excuses_what_a_finer_one_leaves(staying: bool) -> None:
    # What is wrong is what the refinement changes, and its amplitude is free: the test of the floor sees it.
    size = (0.8, 0.8)
    found = assessed(size, size, staying=staying, alike=True)
    assert found.by == (None if staying else "noise") and found.adequate is not staying
    assert (found.p_value < 1e-6) is staying


def test_no_share_of_the_grid_excuses_what_a_finer_one_leaves() -> None:
    excused, refused = assessed((3.0, 3.3), (3.0, 3.3)), assessed((3.0, 3.3), (3.0, 3.3), staying=True)
    assert excused.by == "grid" and refused.by is None
    assert excused.budget["physics"] == 0.0 and refused.budget["discretisation"] == 0.0
    assert refused.p_value < 1e-6 < excused.p_value
    assert refused.rows == excused.rows and all(min(rows.values()) > 100 for rows in refused.rows.values())


def test_the_limit_of_fine_grids_leaves_the_noise_of_a_right_model_and_more_of_a_wrong_one() -> None:
    capture = bar_capture(frames=FRAMES, fps=100.0, fit=(0, SPLIT))
    truth = bar_belief(capture, youngs_modulus=6e4, free=())
    experiment = Experiment.of(recorded(capture, truth, SPACING), Settings(SPACING, workers=1))
    compared = experiment.compare(truth, SPACING)
    name, item = next(iter(compared.items()))
    noise = ratios(whiten_all(compared))
    # An error of the grid, in its square, of 4 and 1 sigma; of a wrong model the same makes up for 5 sigma.
    error = item.observation.sigma * np.random.default_rng(8).choice([-1.0, 1.0], item.predicted.shape)
    coarse, fine = ({name: replace(item, predicted=item.predicted + k * error)} for k in (4.0, 1.0))
    found = ratios_at_zero_spacing(coarse, fine, 2.0)
    assert found[name] == pytest.approx(noise[name], rel=1e-9)
    coarse, fine = ({name: replace(item, predicted=item.predicted + k * error)} for k in (-1.0, -4.0))
    found = ratios_at_zero_spacing(coarse, fine, 2.0)
    assert min(found[name].values()) > 4.9


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


@pytest.mark.parametrize(("everywhere", "excused"), [(False, True), (True, False)])
def test_what_the_grid_bends_of_a_number_it_owes_in_unseen_frames(everywhere: bool, excused: bool) -> None:
    """The grid's error moves the number as far as the fitted frames want it: unseen ones, where the grid is
    right, are then wrong by that number. Where its error is the same there too, a refit takes away all."""
    capture = bar_capture(frames=FRAMES, fps=100.0, fit=(0, SPLIT))
    sequence = replace(capture.sequence("a"), predict=(SPLIT, FRAMES))
    capture = replace(capture, sequences=(sequence,))
    truth = bar_belief(capture, youngs_modulus=6e4, free=("part0.youngs_modulus",))
    experiment = Experiment.of(recorded(capture, truth, SPACING), Settings(SPACING, workers=1))
    name, item = next(iter(experiment.compare(truth, SPACING).items()))
    sigma = item.observation.sigma
    noise = sigma * np.random.default_rng(3).standard_normal(item.observation.position.shape)
    unseen = np.arange(FRAMES)[:, None, None] >= SPLIT
    change = item.jacobian[..., 0]
    change = change * (3.0 * sigma / np.sqrt(np.mean(change[SPLIT:] ** 2)))
    wrong = replace(
        item,
        predicted=item.observation.position - noise - np.where(unseen, change, 0.0),
        refinement=np.where(unseen & (not everywhere), 0.0, change),
        fit=(0, SPLIT),
        predict=(SPLIT, FRAMES),
    )
    found = experiment.assess({name: wrong})
    assert found.ratio[name]["predict"] == pytest.approx(np.sqrt(10.0), rel=0.1)
    assert found.adequate == excused


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
