"""Thresholds: levels that a motion reaches, strengths that a tangent tells there, and what is as it was."""

from __future__ import annotations

from collections.abc import Iterator
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from bar_capture import bar_belief, bar_capture
from extend_example import SPACING, recorded
from mphygs.diagnose import thresholds, trial_ranking
from mphygs.diagnose.finite_trials import Trial
from mphygs.diagnose.rank import rank
from mphygs.diagnose.ranking import RankedEffect
from mphygs.diagnose.thresholds import ABOUT, SHARES, threshold_trials
from mphygs.fit.experiment import Experiment
from mphygs.fit.levenberg_marquardt import Solution, minimise
from mphygs.model import registry, user_effect
from mphygs.model.belief import Belief
from mphygs.model.registry import ParameterSpec, effect
from mphygs.model.user_effect import register_effect
from mphygs.simulate.prediction import Settings

pytestmark = pytest.mark.filterwarnings("ignore:.torch.jit.script. is deprecated:DeprecationWarning")
FREE = ("part0.youngs_modulus",)


class Locking:
    """Stiff beyond a stretch, 1/2 k <I1 - 3 - limit>^2."""

    name = "stretch_lock"
    kind = "threshold"
    parameters = (
        ParameterSpec("limit", "-", 1e3, 1e-4, 1e3, 0.1, role="level", scan=(1e-3, 1.0)),
        ParameterSpec("k", "Pa", 0.0, 0.0, 1e9, 1e5),
    )

    def stress(self, state, parameters):
        beyond = torch.relu(state.deformation.square().sum((1, 2)) - 3.0 - parameters["limit"])
        return 2.0 * parameters["k"] * beyond[:, None, None] * state.deformation


class Below:
    """A drag that only what is slow feels, whatever else its strength adds."""

    name = "slow_drag"
    kind = "threshold"
    parameters = (
        ParameterSpec("limit", "m/s", 1e-9, 1e-9, 1e3, 0.1, role="level", scan=(1e-2, 10.0)),
        ParameterSpec("more", "1/s", 0.0, 0.0, 1e3, 10.0),
    )

    def force(self, state, parameters):
        speed = (state.velocity.square().sum(-1, keepdim=True) + 1e-12).sqrt()
        slow = torch.relu(1.0 - speed / parameters["limit"])
        return -(4.0 + parameters["more"]) * slow * state.mass[:, None] * state.velocity


class Plain:
    """A threshold that says nothing of where it sets in."""

    name = "dead_band"
    kind = "threshold"
    parameters = (ParameterSpec("k", "1/s", 0.0, 0.0, 1e3, 5.0),)

    def force(self, state, parameters):
        speed = (state.velocity.square().sum(-1, keepdim=True) + 1e-12).sqrt()
        return -parameters["k"] * torch.relu(speed - 0.1) * state.mass[:, None] * state.velocity


@pytest.fixture(autouse=True)
def registered(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setattr(registry, "_USER", {})
    monkeypatch.setattr(user_effect, "_IMPLEMENTATIONS", {})
    for cls in (Locking, Below, Plain):
        register_effect(cls)
    yield


def scene(name: str, values: dict[str, float], stiffness: float = 6e4) -> tuple[Experiment, Solution]:
    """A bar shaken by its hold, recorded with an effect, and the model fitted without it."""
    frames = 24
    shake = 0.008 * np.sin(np.linspace(0.0, 9.0, frames))[:, None] * [0.0, 0.3, 1.0]
    capture = bar_capture(frames=frames, fps=60.0, motion=shake, fit=(0, frames))
    belief = bar_belief(capture, youngs_modulus=stiffness, free=FREE)
    capture = recorded(capture, belief.with_effect(name, values))
    experiment = Experiment.of(capture, Settings(SPACING, workers=1))
    return experiment, minimise(experiment.problem(SPACING), belief)


def ranked(name: str, values: dict[str, float], *names: str, stiffness: float = 6e4) -> list[RankedEffect]:
    experiment, fitted = scene(name, values, stiffness)
    found = rank(
        experiment, fitted.belief, fitted.evaluation, SPACING,
        generator=np.random.default_rng(0), names=names,
    )  # fmt: skip
    return list(found.entries)


class Ramp:
    """A problem in closed form: the prediction follows x = 0 ... 2, a strength k adds k <x - limit>."""

    x = np.linspace(0.0, 2.0, 81)
    name, plain, slope = "stretch_lock", 0.0, 1.0

    def __init__(self, residual: np.ndarray, stress: np.ndarray | None = None) -> None:
        self.residual, self.asked = residual, 0
        seen = SimpleNamespace(body=None, von_mises=lambda _belief, last, _feedback: stress[:last])
        self.ranges, self.predictors = {"a": (0, 4)}, {"a": seen}

    def with_ranges(self, ranges: dict) -> Ramp:
        return self

    def feedback(self, name: str) -> None:
        return None

    def beyond(self, limit: float) -> np.ndarray:
        return np.maximum(self.x - limit, 0.0)

    def evaluate(self, belief: Belief, *, jacobian: bool = True) -> SimpleNamespace:
        self.asked += 1
        limit, k = belief[f"{self.name}.limit"].value, belief[f"{self.name}.k"]
        assert [p.key for p in belief.free] == [k.key]
        shape = self.beyond(limit)
        left = self.residual - self.plain * shape - k.value * shape
        return SimpleNamespace(residual=left, jacobian=-k.slope * shape[:, None])

    @property
    def evaluation(self) -> SimpleNamespace:
        one = np.ones((len(self.residual), 1))  # fitted: a constant
        return SimpleNamespace(
            rows={"a": slice(len(self.residual))}, residual=self.residual, jacobian=one
        )


def test_levels_are_shares_of_the_highest_that_is_reached_and_strengths_are_told_by_tangents() -> None:
    belief = bar_belief(bar_capture(), free=())
    ramp = Ramp(residual=np.zeros(81))
    ramp.x = 0.4 * ramp.x  # up to 0.8, of a span of 1e-3 to 1
    ramp.residual = 7e3 * ramp.beyond(0.30)
    trials = threshold_trials(effect("stretch_lock"), ramp, belief, ramp.evaluation)
    tried = {b["stretch_lock.limit"].value for _, b in trials}
    assert len(tried) == thresholds.FEW
    top = max(tried) / min(SHARES, key=lambda s: abs(s * 0.8 - max(tried)))
    assert 0.8 / thresholds.KNOWN_TO < top <= 0.8
    assert all(min(abs(v / top - s) for s in SHARES) < 1e-6 for v in tried)
    # Least squares beside a constant that is free.
    for label, b in trials[:: len(thresholds.TIMES)]:
        limit = b["stretch_lock.limit"].value
        shape = ramp.beyond(limit) - ramp.beyond(limit).mean()
        strength = shape @ ramp.residual / (shape @ shape)
        assert b["stretch_lock.k"].value == pytest.approx(strength, rel=1e-6)
        assert label == f"limit {limit:.4g}"
        own = b["stretch_lock.limit"]
        assert own.log and own.prior_mean == pytest.approx(np.log(limit))
    # The best first, which is the one next to the truth.
    assert abs(np.log(trials[0][1]["stretch_lock.limit"].value / 0.30)) < 0.3
    assert ramp.asked < 20


def test_a_strength_beside_what_acts_without_one_and_a_level_that_acts_below() -> None:
    belief = bar_belief(bar_capture(), free=())

    class Below(Ramp):
        name = "slow_drag"
        plain = 4.0

        def evaluate(self, belief: Belief, *, jacobian: bool = True) -> SimpleNamespace:
            self.asked += 1
            limit, k = belief["slow_drag.limit"].value, belief["slow_drag.more"]
            shape = self.beyond(limit)
            left = self.residual - (self.plain + k.value) * shape
            return SimpleNamespace(residual=left, jacobian=-k.slope * shape[:, None])

        def beyond(self, limit: float) -> np.ndarray:
            return np.maximum(1.0 - (0.5 + self.x) / limit, 0.0)

    slow = Below(np.zeros(81))
    slow.residual = 10.0 * slow.beyond(2.0)
    trials = threshold_trials(effect("slow_drag"), slow, belief, slow.evaluation)
    limit, more = (trials[0][1][f"slow_drag.{name}"].value for name in ("limit", "more"))
    assert 0.5 < limit and abs(np.log(limit / 2.0)) < 0.4
    shape = slow.beyond(limit) - slow.beyond(limit).mean()
    assert 4.0 + more == pytest.approx(shape @ slow.residual / (shape @ shape), rel=1e-6)


def test_what_a_motion_does_not_reach_is_not_tried() -> None:
    belief = bar_belief(bar_capture(), free=())
    ramp = Ramp(np.ones(81))
    ramp.x = ramp.x - 2.0  # never above zero
    assert threshold_trials(effect("stretch_lock"), ramp, belief, ramp.evaluation) == []


def test_yields_are_tried_above_what_the_object_bears_at_the_start() -> None:
    belief = bar_belief(bar_capture(), free=())
    for borne, count in ((0.0, len(SHARES)), (3e3, 3), (9e3, 0)):
        stress = np.full((4, 2, 8), borne)
        stress[1:] = 1e4
        ramp = Ramp(np.zeros(81), stress)
        trials = threshold_trials(effect("plasticity"), ramp, belief, ramp.evaluation)
        tried = [b["plasticity.yield_stress"].value for _, b in trials]
        assert tried == pytest.approx([1e4 * share for share in SHARES][:count])
        assert all(value > borne for value in tried) and not ramp.asked


def test_a_threshold_without_a_level_is_tried_about_its_usual_size() -> None:
    first, *_ = ranked("dead_band", {"k": 6.0}, "dead_band", "viscosity")
    assert (first.effect, first.kind, first.estimate) == ("dead_band", "threshold", {"k": 5.0})
    ramp = Ramp(np.zeros(81))
    trials = threshold_trials(effect("dead_band"), ramp, bar_belief(bar_capture()), ramp.evaluation)
    assert [b["dead_band.k"].value for _, b in trials] == [5.0 * k for k in ABOUT]


def test_a_refit_begins_where_the_materials_give_way_too() -> None:
    experiment, fitted = scene("dead_band", {"k": 6.0})
    belief, free = fitted.belief, FREE[0]
    spec = effect("stretch_lock")
    values = [{"limit": limit, "k": k} for limit, k in ((0.1, 1e3), (0.1, 3e3), (0.2, 1e3))]
    trials = [Trial(spec.name, "", belief.with_effect(spec.name, v)) for v in values]
    scores = SimpleNamespace(drops=np.array([1.0, 2.0, 0.5]), shifts=np.array([[0.1, -0.2, 0.3]]))
    starts = trial_ranking._others(spec, trials[1], trials, scores, belief)
    # Of each level the better strength.
    assert [s.values_of(spec.name) for s in starts] == [values[1], values[2]]
    moduli = [s[free].value / belief[free].value for s in starts]
    assert moduli == pytest.approx(np.exp([-0.2, 0.3]))
    # What only yields, or has no level, is begun from what was tried.
    for name in ("plasticity", "dead_band"):
        assert trial_ranking._others(effect(name), trials[0], trials, scores, belief) == ()


# ---- as it was before levels were scanned ------------------------------------------------------
def test_yielding_and_walls_are_ranked_as_they_were() -> None:
    first, *_ = found = ranked("plasticity", {"yield_stress": 2.5e3}, "plasticity", "contact", "viscosity")
    assert [e.effect for e in found] == ["plasticity", "contact", "viscosity"]
    assert first.label == "yield stress 2804 Pa"
    assert first.statistic == pytest.approx(8128821.77, rel=1e-3)
    wall = {"d": -0.010, "n_x": 0.0, "n_y": 0.0, "n_z": 1.0, "mu": 0.2}
    first, *_ = found = ranked("contact", wall, "plasticity", "contact", "viscosity")
    assert [e.effect for e in found] == ["contact", "viscosity", "plasticity"]
    assert first.statistic == pytest.approx(180655.4, rel=0.02)
    assert found[-1].label == "yield stress 8781 Pa" and found[-1].statistic == 0.0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "values"),
    [("stretch_lock", {"limit": 0.02, "k": 1e4}), ("slow_drag", {"limit": 0.3, "more": 6.0})],
)
def test_a_level_and_a_strength_are_found_together(name: str, values: dict[str, float]) -> None:
    experiment, fitted = scene(name, values)
    found = rank(
        experiment, fitted.belief, fitted.evaluation, SPACING,
        generator=np.random.default_rng(0), names=(name, "viscosity", "plasticity"),
    )  # fmt: skip
    first = found.entries[0]
    assert first.effect == name and first.p_value < 1e-20
    assert first.statistic > 0.5 * (found.chi_square - found.rows)
    refitted = minimise(experiment.problem(SPACING), first.start)
    assert refitted.evaluation.misfit < 1.05
    assert refitted.belief.values_of(name) == pytest.approx(values, rel=0.25)
