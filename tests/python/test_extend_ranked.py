"""Where candidates are ranked: on the frames where the model is nearly right."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from extend_example import (
    SPACING,
    entry_of,
    evaluation_of,
    excess_of,
    plain_belief,
    solution_of,
    step_of,
)
from mphygs.compare.allowance import Allowance
from mphygs.diagnose.ranking import Ranking
from mphygs.extend import ranked
from mphygs.extend.step import Step
from mphygs.extend.window import HALF, ON_THE_WAY
from mphygs.fit.levenberg_marquardt import Solution
from mphygs.model.belief import Belief

# An experiment on one core, of which nothing else is asked.
ALONE = SimpleNamespace(settings=SimpleNamespace(workers=1))


def ranking_of(*promises: float) -> Ranking:
    """Effects that promise these shares of what is beyond the noise of 1000 rows."""
    entries = tuple(entry_of("stiffening", 1e5 * share) for share in sorted(promises, reverse=True))
    return Ranking(entries, 1e5 + 1e3, 1000, None, None)


@pytest.mark.parametrize(
    ("promises", "reason", "again", "chosen"),
    [
        # on the way other materials had made up for what was missing
        ((0.04, 0.1), ON_THE_WAY, (0.4,), "again"),
        ((), ON_THE_WAY, (0.4,), "again"),
        # from the first frames on it is no better
        ((0.04, 0.1), ON_THE_WAY, (0.09,), "first"),
        ((0.04, 0.2), ON_THE_WAY, None, "first"),
        # there is no other window
        ((0.04, 0.1), "converged", None, "first"),
    ],
)
def test_a_window_passed_on_the_way_in_which_nothing_promises_much_is_left_for_the_first_frames(
    promises: tuple[float, ...],
    reason: str,
    again: tuple[float, ...] | None,
    chosen: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    halfway, begun = plain_belief(), plain_belief().with_parameter("part0.youngs_modulus", value=2e5)
    first = replace(solution_of(halfway, evaluation_of(400.0)), reason=reason)
    other = solution_of(begun, evaluation_of(300.0))

    def tractable_window(_e: object, step: Step, *_: object) -> tuple[float, Solution]:
        return (HALF, first) if step.halfway is halfway else (0.4, other)

    def rank(_e: object, belief: Belief, *_: object, share: float, **__: object) -> Ranking:
        assert (share == HALF) is (belief is halfway)
        if belief is halfway:
            return ranking_of(*promises)
        assert again is not None
        return ranking_of(*again)

    monkeypatch.setattr(ranked, "tractable_window", tractable_window)
    monkeypatch.setattr(ranked, "rank", rank)
    monkeypatch.setattr(ranked, "at_other_scales", lambda *_: [])
    monkeypatch.setattr(ranked, "allowance_of", lambda *_, **__: Allowance())
    step = replace(step_of(excess_of(10.0)), halfway=halfway)
    window, afar, ranking = ranked.ranked(ALONE, step, SPACING, np.random.default_rng(0))
    assert window == ((0.4, other) if chosen == "again" else (HALF, first)) and not afar
    assert len(ranking.entries) == len(again if chosen == "again" else promises)


def test_a_promise_is_held_against_what_the_grid_leaves_of_the_excess() -> None:
    """Net of the grid's own directions, 5000 of 100000 are left beyond noise."""
    table = SimpleNamespace(chi_square=6e3, degrees=1000)
    ranking = replace(ranking_of(0.03), table=table)
    assert ranked._promised(ranking) == pytest.approx(0.03)
    assert ranked._promised(ranking, net=True) == pytest.approx(0.6)
    # Trials know of no grid's directions.
    wall = replace(ranking, entries=(entry_of("contact", 3e4, kind="threshold"),))
    assert ranked._promised(wall, net=True) == pytest.approx(0.3)


@pytest.mark.parametrize(
    ("names", "asked"),
    [
        (None, ["base_motion", "gravity", "wind"]),
        (["wind", "fibre"], ["wind"]),
        (["fibre", "tether"], ["fibre", "tether"]),
    ],
)
def test_of_other_scales_that_is_taken_at_which_a_load_promises_most(
    names: list[str] | None, asked: Sequence[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    scales = [solution_of(plain_belief(), evaluation_of(1e4)) for _ in range(3)]
    promised = {id(scales[0]): 2e3, id(scales[1]): 7e3, id(scales[2]): 5e3}
    by_belief = {id(solution.belief): promised[id(solution)] for solution in scales}

    def rank(
        _e: object, belief: Belief, *_: object, trials: bool, names: Sequence[str], **__: object
    ) -> Ranking:
        assert not trials and list(names) == list(asked)
        entries = entry_of("gravity", 1e2), entry_of("base_motion", by_belief[id(belief)])
        return replace(ranking_of(), entries=entries, chi_square=1e4)

    monkeypatch.setattr(ranked, "rank", rank)
    monkeypatch.setattr(ranked, "at_other_scales", lambda *_: scales)
    generator = np.random.default_rng(0)
    found = ranked._from_afar(ALONE, (0.06, scales[0]), SPACING, generator, names, None)
    assert found is scales[1]
    monkeypatch.setattr(ranked, "at_other_scales", lambda *_: [])
    assert ranked._from_afar(ALONE, (0.06, scales[0]), SPACING, generator, names, None) is None
