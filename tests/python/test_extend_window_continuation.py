"""Refits to the first frames: which are followed onward, and how far."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from extend_example import SPACING, entry_of, evaluation_of, plain_belief, solution_of
from mphygs.extend import window_continuation
from mphygs.extend.window_continuation import continued_to_all_frames, with_places_fitted
from mphygs.fit.levenberg_marquardt import Solution
from mphygs.model.belief import Belief
from mphygs.simulate.errors import SimulationError

# An experiment on one core, of which nothing else is asked.
ALONE = SimpleNamespace(settings=SimpleNamespace(workers=1))

KEY = "part0.youngs_modulus"


def test_who_falls_behind_on_the_way_is_not_brought_to_the_end(monkeypatch: pytest.MonkeyPatch) -> None:
    # By effect, chi^2 at each share of the frames that a refit is brought to.
    courses = {
        "viscosity": {0.5: 100.0, 1.0: 100.0},
        "air_drag": {0.5: 120.0, 1.0: 100.0},
        "mass_damping": {0.5: 130.0, 1.0: 110.0},
        "wind": {0.5: 300.0, 1.0: 100.0},  # the fifth, and not alike
        "gravity": {},  # cannot be simulated there
        "plasticity": {0.5: 110.0, 0.75: 900.0, 1.0: 100.0},  # the only one at 0.75
        "relaxation": {0.5: 125.0, 1.0: 301.0},  # three times what the best leaves
    }
    fitted: list[tuple[str, float]] = []
    bounds: dict[tuple[str, float], float] = {}

    def fit(share: float, belief: str, *, hopeless: float) -> object:
        fitted.append((belief, share))
        bounds[belief, share] = hopeless
        if share not in courses[belief]:
            raise SimulationError("unstable")
        return SimpleNamespace(belief=belief, evaluation=evaluation_of(courses[belief][share]))

    monkeypatch.setattr(window_continuation, "fit_onset_then_all", fit)
    monkeypatch.setattr(window_continuation, "movable", lambda _belief: ())
    experiment = SimpleNamespace(window=lambda spacing, share: share, settings=ALONE.settings)
    begun = [
        (
            100.0,
            entry_of(name, 100.0, kind="threshold" if name == "plasticity" else "smooth"),
            SimpleNamespace(belief=name),
        )
        for name in courses
    ]
    lines: list[str] = []
    found = continued_to_all_frames(experiment, 0.25, begun, SPACING, lines.append)
    assert {entry.effect for _, entry, _ in found} == {"viscosity", "air_drag", "mass_damping", "plasticity"}
    assert ("wind", 1.0) not in fitted
    assert [share for name, share in fitted if name == "plasticity"] == [0.5, 0.75, 1.0]
    assert all(solution.evaluation.chi_square < 111.0 for _, _, solution in found)
    # On all frames no more is worth while than three times what the best so far leaves; on the way all is.
    assert bounds["viscosity", 0.5] == bounds["relaxation", 0.5] == np.inf
    assert bounds["mass_damping", 1.0] == window_continuation.BEHIND * 100.0
    few = [item for item in begun if item[1].effect in ("viscosity", "air_drag", "wind")]
    assert any("air_drag" in line and "50%" in line and "sigma" in line for line in lines)
    told = [line for line in lines if line.startswith("followed onward: ")]
    assert told and all("% done, about " in line for line in told)
    # So many go on whatever they leave.
    assert len(continued_to_all_frames(experiment, 0.25, few, SPACING, lines.append)) == 3


def test_from_afar_places_are_fitted_of_all_that_are_not_far_behind(monkeypatch: pytest.MonkeyPatch) -> None:
    nowhere = plain_belief()
    there = nowhere.with_effect("tether", {"k": 1.0}, {"place": [0.0, 0.0, 0.01]})
    asked: list[Solution] = []

    def relocated(share: float, fit: Solution, **_: object) -> Solution:
        assert share == 0.06
        asked.append(fit)
        if len(asked) == 2:
            raise SimulationError("unstable")
        return solution_of(fit.belief, evaluation_of(50.0))

    monkeypatch.setattr(window_continuation, "relocated_anywhere", relocated)
    experiment = SimpleNamespace(window=lambda spacing, share: share, settings=ALONE.settings)
    # The best, another one, one without a place, one at six times the best, one that is far behind.
    left = [(100.0, there), (140.0, there), (150.0, nowhere), (600.0, there), (601.0, there)]
    begun = [(chi, entry_of("tether", 1e4), solution_of(belief, evaluation_of(chi))) for chi, belief in left]
    found = with_places_fitted(experiment, begun, 0.06, SPACING, lambda _text: None)
    assert [id(fit) for fit in asked] == [id(begun[k][2]) for k in (0, 1, 3)]
    assert [chi for chi, _, _ in found] == pytest.approx([50.0, 140.0, 150.0, 50.0, 601.0])
    assert found[3][1] is begun[3][1] and found[3][2] is not begun[3][2]


@pytest.mark.parametrize(
    ("misfit", "beside", "asked"),
    [(1.2, 1.06, [0.5]), (1.01, 1.3, []), (1.6, 1.3, []), (1.2, 1.04, [])],
)
def test_a_place_is_fitted_again_on_the_way_where_more_frames_leave_more_than_noise(
    misfit: float, beside: float, asked: list[float], monkeypatch: pytest.MonkeyPatch
) -> None:
    belief = plain_belief().with_effect("attached_mass", {"m": 1e-3}, {"place": [0.0, 0.0, 0.01]})
    there = solution_of(belief, evaluation_of(40.0))
    again: list[float] = []

    def fit(_share: float, start: Belief, **_: object) -> Solution:
        left = misfit if "attached_mass" in start.effects else beside
        return solution_of(start, evaluation_of(100.0 * left**2))

    def relocated(share: float, _fit: Solution, **_: object) -> Solution:
        again.append(share)
        return there

    monkeypatch.setattr(window_continuation, "fit_onset_then_all", fit)
    monkeypatch.setattr(window_continuation, "relocated_anywhere", relocated)
    experiment = SimpleNamespace(window=lambda spacing, share: share, settings=ALONE.settings)
    # More than are tried at once before it.
    first = solution_of(plain_belief(), evaluation_of(40.0))
    begun = [(90.0, entry_of("air_drag", 1e4), first)] * 8 + [(100.0, entry_of("attached_mass", 1e4), there)]
    continued_to_all_frames(experiment, 0.25, begun, SPACING, lambda _text: None)
    # On all frames it is once its refit is finished.
    assert again == asked
