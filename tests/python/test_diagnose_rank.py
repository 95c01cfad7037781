"""The ranking's entries: by tangents or by trial, and the trials of a recorded object."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.stats import norm

from bar_capture import bar_belief, bar_capture
from extend_example import SPACING, entry_of, recorded
from mphygs.capture.holds import Load
from mphygs.compare.noise import Observation
from mphygs.diagnose import finite_trials, trial_ranking
from mphygs.diagnose import rank as ranking
from mphygs.diagnose.diagnosis_document import ranking_document
from mphygs.diagnose.effect_variants import SINCE_THE_START
from mphygs.diagnose.periodic_variants import periodic_variants
from mphygs.diagnose.rank import rank
from mphygs.diagnose.ranking import RankedEffect, Ranking
from mphygs.diagnose.wall import Plane
from mphygs.fit.experiment import Experiment
from mphygs.fit.levenberg_marquardt import Solution, minimise
from mphygs.fit.placement import masses_of_loads
from mphygs.fit.problem import Problem
from mphygs.model.belief import Belief
from mphygs.model.registry import effect
from mphygs.simulate.prediction import Settings

MASS = 6e-3  # [kg], of a bar of 26 g
HUNG = Load(np.array([[0.05, 0.0, 0.0], [0.06, 0.02, 0.02]]), np.array([0.0, 0.0, -9.81 * MASS]), 0)
FREE = ("part0.youngs_modulus",)


def together(entries: list[RankedEffect], trials: list[RankedEffect]) -> list[RankedEffect]:
    return ranking._with_trials(entries, trials)


# ---- one entry for every effect ---------------------------------------------------------------
def test_a_trial_stands_for_its_effect_where_it_holds_its_own() -> None:
    tangent = entry_of("attached_mass", 1000.0)
    trial = replace(entry_of("attached_mass", 201.0), label="of a load")
    assert together([tangent], [trial]) == [trial]
    poor = replace(trial, statistic=199.0)
    assert together([tangent], [poor]) == [tangent]
    better = replace(trial, statistic=5000.0)
    assert together([tangent], [better]) == [better]


def test_effects_of_one_kind_alone_are_kept_as_they_are() -> None:
    viscosity, mass = entry_of("viscosity", 300.0), entry_of("attached_mass", 100.0)
    wall = entry_of("contact", 50.0, kind="threshold")
    trial = replace(mass, label="of a load", statistic=10.0)
    assert together([viscosity, mass], [wall, trial]) == [viscosity, mass, wall]
    assert together([viscosity, mass], []) == [viscosity, mass]
    assert together([], [wall, trial]) == [wall, trial]


def test_a_trial_counts_where_no_tangent_can_be_told() -> None:
    blind, trial = entry_of("attached_mass", 0.0), replace(entry_of("attached_mass", 40.0), label="of a load")
    assert together([blind], [trial]) == [trial]


# ---- a weight that hangs ----------------------------------------------------------------------
@cache
def scene() -> tuple[Experiment, Solution]:
    """Two recordings of a shaken bar, one with a weight; the model fitted to them knows its pull alone."""
    frames = 24
    shake = 0.006 * np.sin(np.linspace(0.0, 9.0, frames))[:, None] * [0.3, 1.0, 0.0]
    capture = bar_capture(frames=frames, fps=60.0, rest="equilibrium", motion=shake, fit=(0, frames))
    plain = capture.sequence("a")
    capture = replace(capture, sequences=(plain, replace(plain, name="b", loads=(HUNG,))))
    belief = bar_belief(capture, youngs_modulus=8e4, prestress="equilibrium", free=FREE)
    weight = masses_of_loads(capture, ["a", "b"])[0]
    capture = recorded(capture, belief.with_effect("attached_mass", {"m": MASS}, weight))
    experiment = Experiment.of(capture, Settings(SPACING, workers=1))
    return experiment, minimise(experiment.problem(SPACING), belief)


def ranked(*names: str, trials: bool = True) -> Ranking:
    experiment, fitted = scene()
    return rank(
        experiment, fitted.belief, fitted.evaluation, SPACING,
        generator=np.random.default_rng(0), names=names, trials=trials,
    )  # fmt: skip


def test_a_hanging_weights_inertia_is_found_by_trial() -> None:
    found = ranked("attached_mass", "viscosity", "gravity")
    assert [entry.effect for entry in found.entries].count("attached_mass") == 1
    first, *others = found.entries
    assert (first.effect, first.label) == ("attached_mass", "attached_mass, the load of b")
    assert first.estimate == {"m": pytest.approx(MASS)} and first.p_value < 1e-3
    assert first.statistic > 2.0 * others[0].statistic
    # What a refit starts from is the mass of the load, in its sequence alone.
    settings = first.start.term("attached_mass").settings
    assert settings["sequences"] == ["b"] and settings["weight"] is False
    # It really explains that much.
    experiment, fitted = scene()
    after = minimise(experiment.problem(SPACING), first.start).evaluation.chi_square
    drop = fitted.evaluation.chi_square - after
    assert 0.5 < first.statistic / drop < 2.0
    assert after < 1.3 * fitted.evaluation.data_rows
    assert found.chi_square == pytest.approx(fitted.evaluation.chi_square)


def test_thresholds_alone_can_be_ranked() -> None:
    found = ranked("plasticity")
    assert [(entry.effect, entry.kind) for entry in found.entries] == [("plasticity", "threshold")]
    assert found.entries[0].label.startswith("yield stress")
    assert ranked("contact", "plasticity").entries[-1].kind == "threshold"
    # Without trials they are not ranked, and what is smooth is as it was.
    assert ranked("plasticity", trials=False).entries == ()
    smooth, all_of_them = (ranked("gravity", "plasticity", trials=trials) for trials in (False, True))
    assert [(e.effect, e.statistic) for e in smooth.entries] == [
        (e.effect, e.statistic) for e in all_of_them.entries if e.effect == "gravity"
    ]


def test_a_wall_is_refitted_from_every_place_that_was_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """What explains much before a refit, at a wrong place, may beat the wall that stands there."""
    planes = [Plane(np.array([0.0, 0.0, 1.0]), offset) for offset in (-0.2, -0.012, -0.014)]
    belief = scene()[1].belief
    monkeypatch.setattr(trial_ranking, "walls", lambda *_a, **_k: [(belief, plane) for plane in planes])
    (entry,) = ranked("contact").entries
    starts = [entry.start, *entry.others]
    assert sorted(start["contact.d"].value for start in starts) == [-0.2, -0.014, -0.012]
    (sizes,) = ranked("plasticity").entries
    assert sizes.others == ()


def test_what_is_tried_is_read_off_the_sequence_that_is_off_most(monkeypatch: pytest.MonkeyPatch) -> None:
    """The weight hangs in b: the first recording, a, has hardly a misfit, and shows no wall that b meets."""
    experiment, fitted = scene()
    assert fitted.evaluation.worst == "b"
    seen: dict[str, object] = {}

    def found(problem: Problem, observation: Observation, *_: object, **__: object) -> list:
        seen["walls"] = next(iter(problem.ranges)), observation
        return []

    def yields(_spec: object, _capture: object, problem: Problem, *_: object) -> list:
        seen["yields"] = next(iter(problem.ranges))
        return []

    monkeypatch.setattr(trial_ranking, "walls", found)
    monkeypatch.setattr(trial_ranking, "trials_of", yields)
    monkeypatch.setattr(
        ranking,
        "periodic_variants",
        lambda of, transfer, residual, *more, **given: (
            seen.update(swings=residual) or periodic_variants(of, transfer, residual, *more, **given)
        ),
    )
    ranked("contact", "plasticity", "base_motion")
    assert seen["walls"] == ("b", experiment.observations["b"]) and seen["yields"] == "b"
    first, last = experiment.fitted["b"]
    off = experiment.observations["b"].position[first:last] - fitted.evaluation.positions["b"][first:last]
    np.testing.assert_array_equal(seen["swings"], off)


def test_a_softer_object_may_meet_a_wall(monkeypatch: pytest.MonkeyPatch) -> None:
    experiment, fitted = scene()
    soft = fitted.belief.with_parameter(FREE[0], value=0.4 * fitted.belief[FREE[0]].value)
    asked: list[float] = []

    def found(*_: object, share: float, **__: object) -> list[tuple[Belief, Plane]]:
        asked.append(share)
        return [(soft, Plane(np.array([0.0, 0.0, 1.0]), -0.012))]

    monkeypatch.setattr(trial_ranking, "walls", found)
    (entry,) = rank(
        experiment, fitted.belief, experiment.window(SPACING, 0.5).evaluate(fitted.belief), SPACING,
        share=0.5, generator=np.random.default_rng(0), names=("contact",),
    ).entries  # fmt: skip
    assert asked == [0.5] and entry.start[FREE[0]].value == soft[FREE[0]].value


def test_smooth_effects_that_the_motion_cannot_test_are_said_to_be_so() -> None:
    # Nothing moves: neither a viscosity nor a drag does anything.
    capture = bar_capture(frames=8, gravity=np.zeros(3), fit=(0, 8))
    belief = bar_belief(capture, free=FREE)
    experiment = Experiment.of(recorded(capture, belief), Settings(SPACING, workers=1))
    evaluation = experiment.problem(SPACING).evaluate(belief)
    found = rank(
        experiment, belief, evaluation, SPACING,
        generator=np.random.default_rng(0), names=("viscosity", "mass_damping"),
    )  # fmt: skip
    assert {entry.effect for entry in found.entries} == {"viscosity", "mass_damping"}
    for entry in found.entries:
        assert entry.reason and (entry.p_value, entry.statistic, entry.estimate) == (1.0, 0.0, {})


def test_numbers_are_told_by_the_names_of_the_model() -> None:
    names = ("base_motion", "wind", "relaxation", "tether", "stiffness_gradient", "gravity", "plasticity")
    entries = {entry.effect: entry for entry in ranked(*names).entries}
    told = {entry["effect"]: entry for entry in ranking_document(ranked(*names), 1e-4)}
    assert set(told) == set(names)
    for name, document in told.items():
        own = {p.name for p in effect(name).parameters}
        # Those of an effect's settings (where a tether is anchored) stand beside.
        whole = {p.key.removeprefix(f"{name}.") for p in entries[name].start.parameters}
        assert own <= set(document["estimate"]) <= whole
        assert set(document["std"]) <= set(document["estimate"])
        assert set(document["detectable"]) <= own
    shaking = told["base_motion"]
    assert shaking["estimate"]["f"] > 0.0 and set(shaking["detectable"]) == {"a_x", "a_y", "a_z"}
    assert set(told["tether"]["detectable"]) == {"k"} and not told["plasticity"]["detectable"]
    # One parameter with one bound: (z of the test at its share of the level + z of the power) / sqrt(I).
    ratio = told["relaxation"]
    family = len(ranked(*names).table.scores)
    sizes = norm.isf(0.01 / family) + norm.ppf(0.8)
    assert ratio["detectable"]["ratio"] == pytest.approx(sizes * ratio["std"]["ratio"], rel=1e-6)


def test_names_that_were_not_asked_for_are_not_tried(monkeypatch: pytest.MonkeyPatch) -> None:
    tried = {trial_ranking: ["walls"], finite_trials: ["threshold_trials", "hanging_mass_trials"]}
    for module, name in ((module, name) for module, names in tried.items() for name in names):
        monkeypatch.setattr(module, name, lambda *_a, **_k: pytest.fail("a trial that nobody asked for"))
    assert [entry.effect for entry in ranked("viscosity").entries] == ["viscosity"]


def test_a_mass_is_ranked_at_the_place_between_those_tried(monkeypatch: pytest.MonkeyPatch) -> None:
    tried = {score.name for score in ranked("attached_mass").table.scores}
    monkeypatch.setattr(ranking, "variants_between", lambda *_: [])
    corners = {score.name for score in ranked("attached_mass").table.scores}
    between = [label for label in tried - corners if not label.endswith(SINCE_THE_START)]
    assert corners < tried and len(between) == 1
