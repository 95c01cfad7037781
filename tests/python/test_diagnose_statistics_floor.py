"""Blocks, trials of threshold effects, the floor and gains on unseen frames."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2, kstest

from diagnose_toy import COUNT, FRAMES, MARKERS, grid_blocks, smooth_tangents, toy
from mphygs.compare.allowance import Allowance, local_variance, modulated_directions
from mphygs.compare.blocks import part_time_blocks
from mphygs.compare.holm import holm
from mphygs.compare.residual_projection import project_out
from mphygs.compare.verdict_floor import floor_test
from mphygs.diagnose.block_scores import block_scores
from mphygs.diagnose.held_out import gain_interval
from mphygs.diagnose.score import score_candidates
from mphygs.diagnose.trial_scores import score_trials


def test_blocks_cover_parts_and_frames() -> None:
    blocks = grid_blocks()
    assert len(blocks) == 8
    assert [(b.part, b.first, b.last) for b in blocks.blocks[:2]] == [("left", 0, 9), ("left", 10, 19)]
    assert sorted(np.concatenate(blocks.rows())) == list(range(COUNT))
    frame, marker, _ = np.nonzero(np.ones((FRAMES, MARKERS, 3)))
    rows = blocks.rows()[5]
    assert set(marker[rows]) == {3, 4, 5} and set(frame[rows]) == set(range(10, 20))


def test_block_scores_are_normal_under_the_null_and_point_at_the_place() -> None:
    generator = np.random.default_rng(12)
    jacobian, _ = toy(generator)
    tangent = smooth_tangents(generator, 2).reshape(COUNT, -1)
    blocks, projection = grid_blocks(), project_out(jacobian)
    draws = [block_scores(generator.standard_normal(COUNT), projection, tangent, blocks) for _ in range(250)]
    z = np.array([draw.z for draw in draws])
    np.testing.assert_allclose(z.std(0), 1.0, atol=0.2)
    assert kstest(z[:, 3, 1], "norm").pvalue > 0.01
    assert kstest(chi2.sf([draw.statistic[3] for draw in draws], 2), "uniform").pvalue > 0.01
    confined = np.where(blocks.index == 6, tangent[:, 0], 0.0)
    found = block_scores(
        generator.standard_normal(COUNT) + 2.0 * confined, projection, tangent[:, :1], blocks
    )
    assert np.argmax(found.z[:, 0]) == 6 and found.z[6, 0] > 5.0
    drifting = block_scores(
        generator.standard_normal(COUNT) + 3.0 * np.where(blocks.index == 2, jacobian[:, 0], 0.0),
        projection,
        jacobian[:, :1],
        blocks,
    )
    assert np.argmax(np.abs(drifting.z[:, 0])) == 2


def test_block_scores_allow_for_what_the_fit_absorbs_in_the_block() -> None:
    generator = np.random.default_rng(20)
    blocks = grid_blocks()
    tangent = smooth_tangents(generator, 2).reshape(COUNT, -1)
    other = generator.normal(size=COUNT)
    # Parameters that act in block 2 alone, one of them much like the candidate there.
    local = np.where(
        (blocks.index == 2)[:, None], np.column_stack([tangent[:, 0] + 0.5 * other, other**2]), 0.0
    )
    residual = generator.standard_normal(COUNT)
    found = block_scores(residual, project_out(local), tangent, blocks)
    left = residual - local @ np.linalg.lstsq(local, residual, rcond=None)[0]
    inside = np.where((blocks.index == 2)[:, None], tangent, 0.0)
    freed = inside - local @ np.linalg.lstsq(local, inside, rcond=None)[0]
    np.testing.assert_allclose(found.z[2], freed.T @ left / np.linalg.norm(freed, axis=0))
    expected = (freed.T @ left) @ np.linalg.solve(freed.T @ freed, freed.T @ left)
    assert found.statistic[2] == pytest.approx(expected) and found.degrees[2] == 2


def test_trials_have_uniform_p_values_and_find_the_right_one() -> None:
    generator = np.random.default_rng(13)
    jacobian, _ = toy(generator)
    base = smooth_tangents(generator, 1).reshape(COUNT)
    onset = np.nonzero(np.ones((FRAMES, MARKERS, 3)))[0][:, None] >= np.array([[35, 25, 15, 5]])
    changes = 0.1 * base[:, None] * onset
    p_values = np.array(
        [
            score_trials(
                generator.standard_normal(COUNT), jacobian, changes, generator=generator, draws=1000
            ).p_value
            for _ in range(300)
        ]
    )
    for level in (0.05, 0.1, 0.2):
        assert np.mean(p_values <= level) == pytest.approx(level, abs=3.0 * np.sqrt(level / 300))
    strong = 0.6 * base[:, None] * onset
    trials = score_trials(
        generator.standard_normal(COUNT) + strong[:, 2], jacobian, strong, generator=generator
    )
    assert trials.best == 2 and trials.p_value < 1e-6
    left = project_out(jacobian).remaining(generator.standard_normal(COUNT) * 0.0 + strong[:, 2])
    exact = score_trials(strong[:, 2], jacobian, strong, generator=generator)
    assert exact.drop == pytest.approx(left @ left)
    np.testing.assert_allclose(
        project_out(jacobian).remaining(strong[:, 2]),
        strong[:, 2] + jacobian @ exact.shifts[:, 2],
        atol=1e-10,
    )


def test_trials_that_do_nothing_or_are_absorbed_are_not_found() -> None:
    generator = np.random.default_rng(14)
    jacobian, _ = toy(generator)
    residual = generator.standard_normal(COUNT) + 0.1 * jacobian[:, 0]
    trials = score_trials(
        residual, jacobian, np.column_stack([np.zeros(COUNT), jacobian[:, 0]]), generator=generator
    )
    assert not trials.testable.any() and trials.p_value == 1.0
    np.testing.assert_allclose(trials.absorbed, 1.0)
    with pytest.raises(ValueError, match="at least one"):
        score_trials(residual, jacobian, np.zeros((COUNT, 0)), generator=generator)


def test_floor_holds_its_level_and_sees_a_local_fault() -> None:
    generator = np.random.default_rng(15)
    jacobian, _ = toy(generator)
    blocks = grid_blocks()
    floors = [floor_test(generator.standard_normal(COUNT), jacobian, blocks, level=0.05) for _ in range(300)]
    assert kstest([floor.p_value for floor in floors], "uniform").pvalue > 0.01
    assert np.mean([bool(floor.significant_blocks) for floor in floors]) == pytest.approx(0.05, abs=0.04)
    np.testing.assert_allclose(np.mean([floor.block_ratio for floor in floors], 0), 1.0, atol=0.03)
    noise = generator.standard_normal(COUNT)
    assert floor_test(noise, jacobian, blocks).reached
    local = floor_test(noise * np.where(blocks.index == 5, 1.6, 0.9), jacobian, blocks)
    assert local.p_value > 0.001 and local.significant_blocks == (5,) and not local.reached
    everywhere = floor_test(1.2 * noise, jacobian, blocks)
    assert not everywhere.reached and everywhere.chi_square > everywhere.limit
    assert floor_test(0.7 * noise, jacobian, blocks).noise_overstated


def test_floor_of_blocks_that_the_fit_nearly_exhausts() -> None:
    generator = np.random.default_rng(21)
    index = np.repeat(np.arange(10), 12)
    blocks = part_time_blocks(np.zeros(120, int), index, names=("only",), length=1)
    jacobian = np.where((index == 4)[:, None], generator.normal(size=(120, 9)), 0.0)
    floors = [floor_test(generator.standard_normal(120), jacobian, blocks) for _ in range(300)]
    # Before Holm's factor of at most 10 the block's mean square is chi-square with 3 degrees over 3.
    ratio = np.array([floor.block_ratio[4] for floor in floors])
    assert kstest(chi2.sf(3.0 * ratio, 3), "uniform").pvalue > 0.01
    worst = [f for f in floors if np.argmin(f.block_p_values) == 4 and 1e-4 < f.block_p_values[4] < 1.0]
    assert len(worst) > 5
    for floor in worst:
        assert floor.block_p_values[4] == pytest.approx(10.0 * chi2.sf(3.0 * floor.block_ratio[4], 3))


def test_floor_allows_for_a_scale_that_was_itself_measured() -> None:
    generator = np.random.default_rng(16)
    jacobian, _ = toy(generator)
    p_values = {np.inf: [], 60.0: []}
    for _ in range(300):
        noise = generator.standard_normal(COUNT) / np.sqrt(generator.chisquare(60) / 60)
        for degrees, values in p_values.items():
            values.append(floor_test(noise, jacobian, grid_blocks(), noise_degrees=degrees).p_value)
    assert kstest(p_values[60.0], "uniform").pvalue > 0.01
    assert np.mean(np.array(p_values[np.inf]) < 0.01) > 0.15


def test_floor_and_score_with_the_discretisation_allowed_for() -> None:
    """An error of the size of the change under refinement is neither called physics nor a misfit."""
    generator = np.random.default_rng(17)
    jacobian, candidates = toy(generator)
    frame, marker, _ = np.nonzero(np.ones((FRAMES, MARKERS, 3)))
    blocks = grid_blocks()
    delta = smooth_tangents(generator, 1).reshape(COUNT)
    directions = Allowance(directions=modulated_directions(delta, (marker >= 3).astype(int), frame, count=5))
    reached = {"none": 0, "directions": 0, "variance": 0}
    alarms = dict.fromkeys(reached, 0)
    allowances = {"none": None, "directions": directions,
                  "variance": Allowance(variance=local_variance(delta, blocks.index))}  # fmt: skip
    for _ in range(30):
        course = np.cos(np.pi * generator.uniform(0, 2) * frame / FRAMES + generator.uniform(0, 6))
        residual = generator.standard_normal(COUNT) + delta * course
        for name, allowance in allowances.items():
            reached[name] += floor_test(residual, jacobian, blocks, allowance=allowance).reached
            table = score_candidates(residual, jacobian, candidates, generator=generator, allowance=allowance)
            alarms[name] += min(holm({s.name: s.p_value for s in table.scores}).values()) < 0.05
    assert reached["none"] < 3 and reached["directions"] > 26 and reached["variance"] > 26
    assert alarms["none"] > 15 and alarms["directions"] <= 4, alarms
    physics = generator.standard_normal(COUNT) + 0.5 * candidates[1].tangent[:, 0]
    table = score_candidates(physics, jacobian, candidates, generator=generator, allowance=directions)
    assert table.ranked()[0].name == "e1"


def test_gain_interval_covers_the_expected_gain_with_few_blocks() -> None:
    generator = np.random.default_rng(18)
    blocks = np.repeat(np.arange(8), 12)
    covered = []
    for _ in range(400):
        before = generator.standard_normal(96) + np.repeat(generator.normal(size=8), 12)
        after = generator.standard_normal(96)
        interval = gain_interval(before, after, blocks, generator=generator, draws=600)
        # Expected gain: half the variance that every observation loses.
        covered.append(interval.low <= 48.0 <= interval.high)
    assert 0.88 < np.mean(covered) < 0.99


def test_effect_is_accepted_only_when_it_pays_on_unseen_frames() -> None:
    generator = np.random.default_rng(19)
    blocks = np.repeat(np.arange(10), 20)
    noise = generator.standard_normal(200)
    wave = np.sin(np.arange(200) * 0.3)
    pays = gain_interval(noise + wave, noise, blocks, generator=generator)
    assert pays.accepted and pays.gain == pytest.approx(0.5 * ((noise + wave) ** 2 - noise**2).sum())
    accepted = 0
    for _ in range(100):
        noise = generator.standard_normal(200)
        accepted += gain_interval(noise, noise + 0.1 * wave, blocks, generator=generator, draws=400).accepted
    assert accepted <= 4
    once = gain_interval(noise + 8.0 * (blocks == 3), noise, blocks, generator=generator)
    assert once.gain > 0.0 and not once.accepted
    with pytest.raises(ValueError, match="3 blocks"):
        gain_interval(noise[:60], noise[:60], blocks[:60], generator=generator)
