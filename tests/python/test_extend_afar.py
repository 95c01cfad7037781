"""What acts from the first frame on, seen from materials that were not fitted: what the loop makes of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from extend_example import (
    SPACING,
    assessment_of,
    evaluation_of,
    excess_of,
    plain_belief,
    solution_of,
    step_of,
)
from mphygs.compare.allowance import Allowance
from mphygs.extend import (
    conclusion,
    discovery,
    model_selection,
    separating_motions,
    simplest_recordings,
    window_ranking,
)
from mphygs.extend.step import Step
from mphygs.fit.levenberg_marquardt import Solution
from mphygs.fit.stiffness_scale import CONTRAST, about_its_scale
from mphygs.model.belief import Belief
from test_compare_roughness import compared

KEY = "part0.youngs_modulus"
STIFF, SOFT = (about_its_scale(plain_belief().with_parameter(KEY, value=value)) for value in (3e7, 5e4))


@pytest.mark.parametrize("far", [True, False])
def test_the_loop_ranks_and_refits_from_where_it_looks(far: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    afar = solution_of(SOFT, evaluation_of(2e4)) if far else None
    near = solution_of(STIFF, evaluation_of(1e4))
    own = Allowance(directions=np.ones((3, 1)))
    asked: list[tuple[Belief, Allowance]] = []
    begun: list[tuple[Solution, bool]] = []

    def rank(_e: object, belief: Belief, *_: object, allowance: Allowance, **__: object) -> SimpleNamespace:
        asked.append((belief, allowance))
        return SimpleNamespace(entries=(), chi_square=1.0)

    def refits_of(_e: object, _c: object, seen: tuple, *_: object, afar: bool, fates: dict) -> list[object]:
        begun.append((seen[1], afar))
        return []

    patches: dict[str, Callable] = {
        "refits_of": refits_of,
        "on_required_grid": lambda _e, steps, *_, **__: steps[-1], "reconciled": lambda _e, step, _r: step,
        "mask_outliers": lambda *_: 0, "sequences_without_loads": lambda _e: (),
        "with_effects_exchanged": lambda *_, **__: None,
        "candidate_rows": lambda *_: (), "undetermined": lambda *_: (), "bounded": lambda step, _e: step,
    }  # fmt: skip
    for name, function in patches.items():
        monkeypatch.setattr(discovery, name, function)
    seen_at: dict[str, Callable] = {
        "tractable_window": lambda *_: (0.06, near), "_from_soft_materials": lambda *_: afar,
        "allowance_of": lambda *_, **__: own, "rank": rank,
    }  # fmt: skip
    for name, function in seen_at.items():
        monkeypatch.setattr(window_ranking, name, function)
    steps = [step_of(excess_of(10.0))]
    unseen = SimpleNamespace(capture=SimpleNamespace(sequences=()), observations={})
    discovery.discover_effects(unseen, plain_belief(), SPACING, start=steps)
    (belief, allowance), (seen, from_afar) = asked[0], begun[0]
    assert (belief, seen, from_afar) == ((SOFT, afar, True) if far else (STIFF, near, False))
    # From afar the grid's error is that of another motion.
    assert allowance.directions is None if far else allowance is own


def test_a_doubted_sigma_is_told_at_the_end_only() -> None:
    last = replace(step_of(assessment_of(3.0), added=()), compared=compared(3e-4, 1e-4))
    told = conclusion.conclude([last], [], ["earlier"])
    assert told.warnings[0] == "earlier" and "sigma (0.1 mm" in told.warnings[1]
    assert conclusion.conclude([last], [], ["earlier"], final=False).warnings == ("earlier",)


def test_numbers_that_were_found_about_another_scale_are_carried_with_its_bounds() -> None:
    """The first model was stiff, what was found is softer than its bounds allow."""
    assert STIFF[KEY].lower > SOFT[KEY].value
    first, found = (replace(step_of(assessment_of(2.0)), belief=belief) for belief in (STIFF, SOFT))
    assert separating_motions._without_last(first, found)[KEY] == SOFT[KEY]
    # Bounds that no scale gave are kept.
    stated = plain_belief().with_parameter(KEY, value=2e5, lower=1e5, upper=3e5)
    bare = plain_belief().with_parameter(KEY, value=5e4)
    assert stated[KEY].found(bare[KEY]) == replace(stated[KEY], value=1e5)
    assert bare[KEY].found(STIFF[KEY]) == STIFF[KEY]


@pytest.mark.parametrize("free", [True, False])
def test_all_recordings_take_the_scale_of_the_simplest(free: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    bare = step_of(excess_of(2.0))
    monkeypatch.setattr(
        simplest_recordings, "step_at", lambda _e, belief, *_, **__: replace(bare, belief=belief)
    )
    first = STIFF.with_parameter(KEY, prior_mean=float(np.log(1e5)), prior_std=2.0)
    step = replace(bare, belief=SOFT.with_parameter(KEY, free=free))
    p = simplest_recordings.compared_on_all(SimpleNamespace(), first, step).belief[KEY]
    value = 5e4 if free else 1e5
    assert (p.value, p.lower, p.upper) == pytest.approx((value, value / CONTRAST, value * CONTRAST))


def test_a_rival_is_tried_with_the_best_steps_materials(monkeypatch: pytest.MonkeyPatch) -> None:
    tried: list[Belief] = []

    def closest(_problem: object, beliefs: tuple[Belief, ...]) -> Belief:
        tried.extend(beliefs)
        return beliefs[1]

    monkeypatch.setattr(model_selection, "best_fitting", closest)
    rival, best = (replace(step_of(excess_of(2.0)), belief=belief) for belief in (STIFF, SOFT))
    nearest: Step | None = model_selection._nearest(None, rival, best)
    assert tried[0] == STIFF and nearest.belief[KEY] == SOFT[KEY]
