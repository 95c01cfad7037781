"""What is tried at finite values."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bar_capture import bar_belief, bar_capture
from mphygs.diagnose.planes import Plane
from mphygs.diagnose.trials import DECADES, THRESHOLDS, Trial, trials_of
from mphygs.model import registry
from mphygs.model.belief import Belief
from mphygs.model.descriptor import EffectSpec, ParameterSpec

TRANSFER = "total-lagrangian"


def tried(belief: Belief | None = None, *, planes: tuple[Plane, ...] = (), **more: object) -> list[Trial]:
    capture = more.pop("capture", None) or bar_capture()
    return trials_of(belief or bar_belief(capture, free=()), capture, TRANSFER, ["a"], planes, **more)


def test_holds_give_way_over_decades_where_there_are_any() -> None:
    trials = tried(names=["hold_compliance"])
    given = [trial.belief["hold_compliance.compliance"].value for trial in trials]
    spec = next(p for p in registry.effect("hold_compliance").parameters)
    assert given == pytest.approx(np.geomspace(*spec.range, DECADES))
    assert tried(trials[0].belief, names=["hold_compliance"]) == []
    capture = bar_capture()
    free = replace(capture, sequences=tuple(replace(s, held=()) for s in capture.sequences))
    assert tried(capture=free, names=["hold_compliance"]) == []


def test_a_yield_stress_is_tried_over_all_of_its_range_and_stays_near_what_was_tried() -> None:
    trials = tried(names=["plasticity"])
    stress = [trial.belief["plasticity.yield_stress"] for trial in trials]
    spec = registry.effect("plasticity").parameters[0]
    assert [p.value for p in stress] == pytest.approx(np.geomspace(*spec.range, THRESHOLDS))
    assert all(p.free and p.prior_mean == pytest.approx(np.log(p.value)) for p in stress)
    assert tried(trials[0].belief, names=["plasticity"]) == []


@pytest.mark.parametrize(("scan", "values"), [((10.0, 10.0), [10.0]), (None, [0.5, 1.5, 5.0, 15.0])])
def test_a_threshold_of_ones_own_is_tried_where_it_says_or_about_its_usual_size(
    scan: tuple[float, float] | None, values: list[float]
) -> None:
    own = ParameterSpec("depth", "m", 0.0, 0.0, 100.0, 5.0, scan=scan)
    beside = ParameterSpec("amount", "-", 0.0, 0.0, 10.0, 2.0)
    spec = EffectSpec("snap_of_trials", "", "threshold", "user", (own, beside))
    registry.register(spec)
    try:
        trials = [t for t in tried(names=["snap_of_trials"]) if ", depth" in t.label]
    finally:
        registry._USER.pop("snap_of_trials")
    assert [t.belief["snap_of_trials.depth"].value for t in trials] == pytest.approx(values)
    assert all(t.belief["snap_of_trials.amount"].value == 2.0 for t in trials)


def test_planes_are_tried_with_their_direction_free_and_its_length_kept() -> None:
    plane = Plane((0.6, 0.0, 0.8), -0.02, 1.0)
    (trial,) = tried(planes=(plane,), names=["contact"])
    there = trial.belief
    assert there["contact.d"].value == -0.02 and trial.label == plane.label
    assert [there[f"contact.n_{a}"].value for a in "xyz"] == [0.6, 0.0, 0.8]
    assert all(there[f"contact.n_{a}"].free and there[f"contact.n_{a}"].prior_std for a in "xyz")
    assert there["contact.mu"].value > 0.0
    assert tried(names=["contact"]) == []
