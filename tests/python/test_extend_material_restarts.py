"""Refits from afar, begun once more from the best one's materials."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from extend_example import SPACING, entry_of, evaluation_of, plain_belief, solution_of
from mphygs.extend import material_restarts
from mphygs.extend.material_restarts import restarted_from_best_materials
from mphygs.extend.window_continuation import LINEAR, Begun
from mphygs.fit.levenberg_marquardt import Solution
from mphygs.model.belief import Belief
from mphygs.simulate.errors import SimulationError

KEY = "part0.youngs_modulus"
SHARE = 0.06


def begun_with(left: dict[str, float], *, rows: int = 100) -> list[Begun]:
    """Refits by effect, with chi^2; each has found a modulus of its own."""
    out = []
    for number, (name, chi_square) in enumerate(left.items()):
        belief = plain_belief().with_parameter(KEY, value=1e5 + number).with_effect(name)
        kind = "threshold" if name == "contact" else "smooth"
        fit = solution_of(belief, evaluation_of(chi_square, rows))
        out.append((chi_square, entry_of(name, 1e4 - number, kind=kind), fit))
    return out


def lend(
    monkeypatch: pytest.MonkeyPatch, begun: list[Begun], left: dict[str, float | None]
) -> tuple[list[Begun], list[Belief], list[str]]:
    """What comes of refits that leave so much once they are begun anew (None: cannot be simulated), the
    materials they are begun from, and what was asked for."""
    seen: list[Belief] = []
    asked: list[str] = []

    def evaluate(belief: Belief) -> object:
        seen.append(belief)
        assert "tether" not in belief.effects
        return evaluation_of(9e4)

    def rank(_experiment: object, belief: Belief, *_: object, names: list[str], **options: object) -> object:
        assert options["share"] == SHARE and options["trials"] is False
        asked.extend(names)
        entries = [replace(entry_of(name, 1.0), label=f"{name} anew", estimate={"k": 1.0}) for name in names]
        return SimpleNamespace(entries=entries)

    def start(_own: object, before: Solution, entry: object, *_: object, **__: object) -> Solution | None:
        chi_square = left[entry.effect]
        return None if chi_square is None else solution_of(before.belief, evaluation_of(chi_square))

    monkeypatch.setattr(material_restarts, "rank", rank)
    monkeypatch.setattr(material_restarts, "start_refit", start)
    monkeypatch.setattr(material_restarts, "with_places_fitted", lambda _experiment, items, *_: items)
    experiment = SimpleNamespace(
        window=lambda _spacing, _share: SimpleNamespace(evaluate=evaluate),
        settings=SimpleNamespace(workers=1),
    )
    found = restarted_from_best_materials(
        experiment, begun, SHARE, SPACING, np.random.default_rng(0), lambda _text: None,
        iterations=8, accuracy=1e-4,
    )  # fmt: skip
    return found, seen, asked


def test_what_does_better_from_the_best_ones_materials_is_taken_from_there(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    begun = begun_with(
        {"wind": 300.0, "tether": 120.0, "gravity": 150.0, "base_motion": 900.0, "contact": 500.0}
    )
    left = {"wind": 101.0, "gravity": 160.0, "base_motion": None}
    found, seen, asked = lend(monkeypatch, begun, left)
    # Not the best one itself, nor what sets in.
    assert asked == ["wind", "gravity", "base_motion"]
    assert seen[0][KEY].value == 1e5 + 1
    assert [chi_square for chi_square, _, _ in found] == [101.0, 120.0, 150.0, 900.0, 500.0]
    assert found[0][1].label == "wind anew" and found[0][1].statistic == begun[0][1].statistic
    assert all(new is old for new, old in zip(found[1:], begun[1:], strict=True))


@pytest.mark.parametrize("left", [{"wind": 1.01 * LINEAR**2 * 100, "tether": 900.0}, {"wind": 120.0}])
def test_nothing_is_lent_by_one_that_is_far_off_or_alone(
    left: dict[str, float], monkeypatch: pytest.MonkeyPatch
) -> None:
    begun = begun_with(left)
    found, seen, asked = lend(monkeypatch, begun, {})
    assert found == begun and not seen and not asked


def test_materials_that_cannot_be_simulated_without_the_effect_are_not_lent() -> None:
    def evaluate(_belief: Belief) -> object:
        raise SimulationError("unstable")

    begun = begun_with({"wind": 120.0, "tether": 130.0})
    experiment = SimpleNamespace(window=lambda *_: SimpleNamespace(evaluate=evaluate))
    found = restarted_from_best_materials(
        experiment, begun, SHARE, SPACING, np.random.default_rng(0), lambda _text: None,
        iterations=8, accuracy=1e-4,
    )  # fmt: skip
    assert found == begun
