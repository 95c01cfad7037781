"""What is tried at finite values."""

from __future__ import annotations

from dataclasses import replace

import pytest

from bar_capture import bar_belief, bar_capture
from mphygs.diagnose.finite_trials import YIELDING, hold_trials
from mphygs.model.registry import effect

HOLD = effect("hold_compliance")


def test_holds_give_way_by_shares_of_the_object_under_its_weight() -> None:
    capture = bar_capture()
    belief = bar_belief(capture, free=())
    part = capture.parts[0]
    weight = part.volume * belief[f"{part.name}.density"].value * 9.81
    belief = replace(belief, gravity=belief.gravity * 0.0)
    trials = hold_trials(HOLD, capture, belief)
    given = [trial.belief["hold_compliance.compliance"].value * weight for trial in trials]
    assert given == pytest.approx([share * capture.diagonal for share in YIELDING])
    assert {trial.effect for trial in trials} == {"hold_compliance"}
    free = replace(capture, sequences=tuple(replace(s, held=()) for s in capture.sequences))
    assert hold_trials(HOLD, free, belief) == []
