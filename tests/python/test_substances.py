"""What soft things are made of: words, presets, priors."""

import math
from pathlib import Path

import pytest

from command_example import SPACING, answer, call, make_capture
from mphygs.capture.format import Known, load_capture
from mphygs.commands import fit as command
from mphygs.fit.start import DEFAULT_DENSITY, YOUNGS_MODULUS_MEDIAN, starting_belief
from mphygs.model.substances import SUBSTANCES, like, substance


@pytest.mark.parametrize(
    ("modulus", "words"),
    [
        (5e3, "like a gel"),
        (7e4, "like soft silicone"),
        (6e5, "like soft plant tissue or silicone or a plant's stem"),
        (2e6, "like rubber or soft plant tissue or silicone or a plant's stem"),
        (1e2, "softer than any gel"),
        (2e11, "stiffer than anything soft"),
    ],
)
def test_words_of_a_stiffness(modulus: float, words: str) -> None:
    assert like(modulus) == words


def test_presets_hold_their_range() -> None:
    for one in SUBSTANCES:
        assert one.median * math.exp(2 * one.spread) == pytest.approx(one.stiffest)
        assert like(one.median) != like(1e2)
    with pytest.raises(KeyError, match="unknown preset 'jelly'; expected one of gel, silicone"):
        substance("jelly")


def test_a_preset_is_where_a_fit_starts(tmp_path: Path) -> None:
    capture = load_capture(make_capture(tmp_path / "c", known=Known()))
    plain, gel = starting_belief(capture), starting_belief(capture, preset="silicone")
    assert plain["bar.youngs_modulus"].value == YOUNGS_MODULUS_MEDIAN
    assert plain["bar.density"].value == DEFAULT_DENSITY
    assert gel["bar.youngs_modulus"].value == substance("silicone").median
    assert gel["bar.youngs_modulus"].prior_std < plain["bar.youngs_modulus"].prior_std
    assert gel["bar.density"].value == 1070.0


def test_the_fit_finds_the_same_and_says_what_it_is_like(tmp_path: Path) -> None:
    capture = make_capture(tmp_path / "c")
    options = ("--effects", "viscosity", "--spacing", SPACING, "--workers", 1)
    found = {
        name: answer(command.main, capture, "--out", tmp_path / name, *options, *given)
        for name, given in {"plain": (), "silicone": ("--preset", "silicone")}.items()
    }
    values = [run["parameters"]["bar.youngs_modulus"] for run in found.values()]
    assert abs(values[0]["value"] - values[1]["value"]) < 0.2 * values[0]["std"]
    assert found["silicone"]["like"] == {"bar.youngs_modulus": "like silicone"}
    code, out, _ = call(command.main, "--out", tmp_path / "plain", "--resume", "--workers", 1)
    assert code == 0 and "by its stiffness: bar like silicone" in out
    code, _, said = call(command.main, capture, "--preset", "jelly")
    assert code == 2 and "--preset" in said
