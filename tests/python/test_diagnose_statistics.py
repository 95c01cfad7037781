"""Families of candidates, decoys, ties, power, blocks, trials, the floor and held-out gains."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2, kstest, norm

from mphygs.diagnose.allowance import Allowance, local_variance, modulated_directions
from mphygs.diagnose.block_scores import block_scores
from mphygs.diagnose.blocks import Blocks, part_time_blocks
from mphygs.diagnose.decoys import check_decoys, decoy_tangents
from mphygs.diagnose.held_out import gain_interval
from mphygs.diagnose.multiplicity import holm, simulate_family
from mphygs.diagnose.power import (
    detectable_along,
    detectable_length,
    detectable_strength,
    least_visible_direction,
)
from mphygs.diagnose.projection import project_out
from mphygs.diagnose.score import score_candidates
from mphygs.diagnose.score_table import Candidate, ScoreTable
from mphygs.diagnose.ties import compare_pair, separating_motions, tied_with
from mphygs.diagnose.trials import score_trials
from mphygs.diagnose.verdict_floor import floor_test

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


def test_holm_gives_the_textbook_adjustment() -> None:
    adjusted = holm({"a": 0.01, "b": 0.04, "c": 0.03, "d": 0.005})
    assert adjusted == pytest.approx({"a": 0.03, "b": 0.06, "c": 0.06, "d": 0.02})
    assert list(adjusted) == ["a", "b", "c", "d"]
    with pytest.raises(ValueError, match="a: p-value"):
        holm({"a": np.nan})


def test_holm_keeps_the_familywise_error_and_beats_bonferroni() -> None:
    generator = np.random.default_rng(1)
    draws = generator.random((2000, 8))
    wrong = np.mean([min(holm(dict(enumerate(row))).values()) < 0.05 for row in draws[:, :8]])
    assert wrong == pytest.approx(0.05, abs=0.016)
    assert holm({"a": 0.001, "b": 0.02})["b"] == pytest.approx(0.02)


@pytest.mark.parametrize("sigma_known", [True, False])
def test_family_p_value_is_uniform_for_the_leader_under_the_null(sigma_known: bool) -> None:
    generator = np.random.default_rng(2)
    jacobian, candidates = toy(generator)
    scale = 1.0 if sigma_known else 2.5
    law = None
    leaders, drops = [], []
    for _ in range(200):
        residual = scale * generator.standard_normal(COUNT)
        table = table_of(residual, jacobian, candidates, sigma_known=sigma_known)
        if law is None:
            law = simulate_family(table, generator=generator)
        leaders.append(min(law.p_value(score) for score in table.scores))
        drops.append(law.p_value_of_drop(max(score.drop for score in table.scores) / scale**2))
    assert kstest(leaders, "uniform").pvalue > 0.01
    assert kstest(drops, "uniform").pvalue > 0.01


def test_family_p_value_of_a_strong_effect_follows_the_union_bound() -> None:
    generator = np.random.default_rng(3)
    jacobian, candidates = toy(generator)
    residual = generator.standard_normal(COUNT) + candidates[1].tangent[:, 0] * 0.5
    table = table_of(residual, jacobian, candidates)
    law = simulate_family(table, generator=generator, draws=500)
    assert table["e1"].drop > 64.0
    assert law.p_value(table["e1"]) == pytest.approx(7 * table["e1"].p_value)


def test_decoys_are_as_smooth_as_the_candidates_and_not_among_them() -> None:
    generator = np.random.default_rng(4)
    tangents = smooth_tangents(generator, 8) * np.logspace(-5, 5, 8)
    decoys = decoy_tangents(tangents, 30, generator=generator)

    def roughness(series: np.ndarray) -> np.ndarray:
        return (np.diff(series, axis=0) ** 2).sum((0, 1, 2)) / (series**2).sum((0, 1, 2))

    assert np.median(roughness(decoys)) == pytest.approx(np.median(roughness(tangents)), rel=0.6)
    white = generator.normal(size=decoys.shape)
    assert roughness(decoys).max() < 0.2 * roughness(white).min()
    unit = tangents.reshape(COUNT, -1) / np.linalg.norm(tangents.reshape(COUNT, -1), axis=0)
    assert np.abs(unit.T @ decoys.reshape(COUNT, -1)).max() < 0.95
    with pytest.raises(ValueError, match="at least one tangent"):
        decoy_tangents(np.zeros_like(tangents), 3, generator=generator)


def test_decoys_hold_their_level_on_noise_and_give_understated_noise_away() -> None:
    generator = np.random.default_rng(5)
    tangents = smooth_tangents(generator, 8)
    decoys = decoy_tangents(tangents, 30, generator=generator).reshape(COUNT, -1)
    candidates = [candidate(f"decoy {k}", decoys[:, k]) for k in range(30)]
    jacobian = smooth_tangents(generator, 3).reshape(COUNT, -1)
    shares, p_values, inflated = [], [], []
    for _ in range(60):
        noise = generator.standard_normal(COUNT)
        good = check_decoys(table_of(noise, jacobian, candidates), generator=generator, draws=300)
        bad = check_decoys(table_of(2.5 * noise, jacobian, candidates), generator=generator, draws=300)
        shares.append(good.false_alarm_share)
        p_values.append(good.p_value)
        inflated.append(bad.p_value < 0.05)
    assert np.mean(shares) == pytest.approx(0.05, abs=0.03)
    assert np.mean(np.array(p_values) < 0.05) < 0.15
    assert np.mean(inflated) > 0.8
    assert bad.inflation == pytest.approx(6.25 * good.inflation)


def test_a_real_effect_stands_out_from_decoys() -> None:
    generator = np.random.default_rng(6)
    jacobian, candidates = toy(generator)
    decoys = decoy_tangents(smooth_tangents(generator, 8), 40, generator=generator).reshape(COUNT, -1)
    residual = generator.standard_normal(COUNT) + candidates[1].tangent[:, 0]
    table = table_of(
        residual, jacobian, [candidates[1], *(candidate(str(k), decoys[:, k]) for k in range(40))]
    )
    decoy_table = table_of(residual, jacobian, [candidate(str(k), decoys[:, k]) for k in range(40)])
    check = check_decoys(decoy_table, generator=generator)
    assert check.stands_out(table["e1"]) == pytest.approx(1 / 41)
    assert check.stands_out(table["0"]) > 1 / 41


def test_tie_is_the_formula_for_single_parameters() -> None:
    generator = np.random.default_rng(7)
    jacobian, _ = toy(generator)
    first, second = smooth_tangents(generator, 2).reshape(COUNT, 2).T
    second = first + 0.5 * second
    residual = generator.standard_normal(COUNT) + 0.4 * first
    table = table_of(residual, jacobian, [candidate("e", first), candidate("f", second)])
    projection = project_out(jacobian)
    one, two = projection.remaining(first), projection.remaining(second)
    correlation = one @ two / np.sqrt((one @ one) * (two @ two))
    tie = compare_pair(table, "e", "f")
    assert tie.correlation == pytest.approx(abs(correlation))
    assert tie.expected == pytest.approx(table["e"].statistic * (1.0 - correlation**2))
    # Observed: the score of e once f has been projected out as well.
    after = table_of(residual, np.column_stack([jacobian, second]), [candidate("e", first)])
    assert tie.observed == pytest.approx(after["e"].statistic)


def test_collinear_effects_are_tied_and_independent_ones_are_not() -> None:
    generator = np.random.default_rng(8)
    jacobian, _ = toy(generator)
    base, other, third = smooth_tangents(generator, 3).reshape(COUNT, 3).T
    candidates = [
        candidate("truth", base),
        candidate("twin", 3.0 * base + 0.05 * other),
        candidate("other", other),
        candidate("wrong way", -base - 0.05 * third, bounded=True),
        candidate("pair", np.column_stack([base + 0.05 * other, third])),
    ]
    residual = generator.standard_normal(COUNT) + 0.5 * base
    table = table_of(residual, jacobian, candidates)
    assert {tie.rival for tie in tied_with(table, "truth")} == {"twin", "pair"}
    assert compare_pair(table, "truth", "wrong way").correlation > 0.99
    assert compare_pair(table, "pair", "truth").expected < 9.0


def test_the_separating_motion_is_the_one_where_the_tangents_differ() -> None:
    generator = np.random.default_rng(9)
    jacobian, _ = toy(generator)
    base, other = smooth_tangents(generator, 2).reshape(COUNT, 2).T
    silent = np.zeros(COUNT)
    tables = {
        "alike": table_of(silent, jacobian, [candidate("e", base), candidate("f", base + 0.01 * other)]),
        "apart": table_of(silent, jacobian, [candidate("e", base), candidate("f", other)]),
    }
    ranked = separating_motions(tables, "e", "f", increment=np.array([0.5]))
    assert [name for name, _ in ranked] == ["apart", "alike"]
    left = project_out(np.column_stack([jacobian, other])).remaining(base)
    assert ranked[0][1] == pytest.approx(0.25 * left @ left)


@pytest.mark.parametrize(("columns", "bounded"), [(1, True), (1, False), (3, False), (3, True)])
def test_power_at_the_smallest_detectable_strength(columns: int, bounded: bool) -> None:
    generator = np.random.default_rng(10)
    jacobian, _ = toy(generator)
    effect = candidate("e", smooth_tangents(generator, columns).reshape(COUNT, -1), bounded=bounded)
    score = table_of(np.zeros(COUNT), jacobian, [effect])["e"]
    strength = detectable_strength(score, level=0.05, family=10)
    if columns == 1 and bounded:
        formula = (norm.isf(0.005) + norm.ppf(0.8)) / np.sqrt(score.information[0, 0])
        assert strength[0] == pytest.approx(formula)
    found = [
        table_of(generator.standard_normal(COUNT) + effect.tangent[:, 0] * strength[0], jacobian, [effect])
        for _ in range(400)
    ]
    share = np.mean([table["e"].p_value < 0.005 for table in found])
    assert 0.75 < share < (0.85 if columns == 1 else 0.9)


def test_detectable_strength_by_direction_and_of_what_cannot_be_seen() -> None:
    generator = np.random.default_rng(11)
    jacobian, _ = toy(generator)
    tangent = smooth_tangents(generator, 2).reshape(COUNT, -1) * [1.0, 0.1]
    score = table_of(np.zeros(COUNT), jacobian, [candidate("e", tangent)])["e"]
    worst = least_visible_direction(score)
    strengths = detectable_strength(score, level=0.05, family=5)
    assert detectable_along(score, worst, level=0.05, family=5) >= strengths.max() * (1.0 - 1e-9)
    assert detectable_along(score, np.array([2.0, 0.0]), level=0.05, family=5) == pytest.approx(strengths[0])
    absorbed = table_of(np.zeros(COUNT), jacobian, [candidate("e", jacobian[:, :1])])["e"]
    assert np.isinf(detectable_strength(absorbed, level=0.05, family=5)).all()
    with pytest.raises(ValueError, match="not testable"):
        detectable_length(absorbed, level=0.05, family=5)


def grid_blocks(length: int = 10) -> Blocks:
    frame, marker, _ = np.nonzero(np.ones((FRAMES, MARKERS, 3)))
    return part_time_blocks((marker >= 3).astype(int), frame, names=("left", "right"), length=length)


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
