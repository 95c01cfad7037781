"""What is tried at finite values."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from bar_capture import bar_belief, bar_capture
from mphygs.diagnose.trials_of import YIELD_SHARES, YIELDING, hold_trials, threshold_trials
from mphygs.model.registry import effect

HOLD, YIELD = effect("hold_compliance"), effect("plasticity")


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


def test_yields_are_tried_above_what_the_object_bears_at_the_start() -> None:
    belief = bar_belief(bar_capture(), free=())
    for borne, count in ((0.0, len(YIELD_SHARES)), (3e3, 3), (9e3, 0)):
        stress = np.full((4, 2, 8), borne)
        stress[1:] = 1e4
        asked = SimpleNamespace(von_mises=lambda _belief, last, stress=stress: stress[:last])
        trials = threshold_trials(YIELD, asked, belief, 4)
        tried = [trial.belief["plasticity.yield_stress"].value for trial in trials]
        assert tried == pytest.approx([1e4 * share for share in YIELD_SHARES][:count])
        assert all(value > borne for value in tried)
