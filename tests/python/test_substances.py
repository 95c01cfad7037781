"""What soft things are made of: words, presets, priors."""

import math
from dataclasses import replace
from pathlib import Path

import pytest

from bar_capture import bar_capture
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


def test_a_preset_by_part_is_that_of_the_last_entry_that_names_it() -> None:
    capture = bar_capture(lengths=(0.02, 0.02, 0.02))
    plain = starting_belief(capture)
    own = starting_belief(capture, preset="part[12] = petal, part0=stem,part2=gel")
    for name, preset in (("part0", "stem"), ("part1", "petal"), ("part2", "gel")):
        p = own[f"{name}.youngs_modulus"]
        assert (p.value, p.prior_std) == (substance(preset).median, substance(preset).spread)
        assert p.prior_mean == pytest.approx(math.log(substance(preset).median))
    # A part that none names is as without, and a density that is stated tells more than a substance.
    only = starting_belief(capture, preset="part0=rubber")
    assert only["part1.youngs_modulus"] == plain["part1.youngs_modulus"]
    assert (only["part0.density"].value, only["part1.density"].value) == (930.0, DEFAULT_DENSITY)
    known = replace(capture, known=Known(density={"part1": 700.0}))
    assert starting_belief(known, preset="part0=rubber")["part0.density"].value == 700.0


@pytest.mark.parametrize(
    ("preset", "said"),
    [
        ("leaf=petal", "--preset: no part 'leaf'; expected some of bar"),
        ("bar=jelly", "--preset: unknown preset 'jelly'; expected one of gel, silicone"),
        ("bar=", "--preset: got 'bar='; expected a substance, or part=substance"),
        ("=gel", "--preset: got '=gel'; expected a substance"),
        ("", "--preset: got ''; expected a substance"),
    ],
)
def test_a_preset_that_names_nothing_is_refused_in_one_line(preset: str, said: str, tmp_path: Path) -> None:
    capture = make_capture(tmp_path / "c")
    code, _, line = call(command.main, capture, "--out", tmp_path / "run", "--preset", preset)
    assert code == 2 and said in line and len(line.strip().splitlines()) == 1


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
