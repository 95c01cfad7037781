"""Captures say the truth: put into the model, it explains them to the noise."""

import json

import numpy as np
import pytest

from mphygs.capture.format import load_capture
from mphygs.simulate.prediction import Predictor, Settings
from mphygs.synth import embedded_capture
from mphygs.synth.make import make_capture
from mphygs.synth.recipe import Recipe, default_takes, recipe, truth_spacing
from mphygs.synth.shapes import shape
from mphygs.synth.truth import true_belief
from synth_example import made, small, tracks


def residual(capture, made_of: Recipe, share: float) -> float:
    """Root mean square over sigma of what the true model leaves, at a share as `Recipe` states it."""
    recording = capture.sequences[0]
    spacing = truth_spacing(share, sum(part.volume for part in capture.parts))
    settings = Settings(spacing=spacing, workers=1)
    predicted = Predictor(capture, recording, settings).predict(true_belief(capture, made_of, made_of.hidden))
    difference = recording.markers.position - predicted.position
    return float(np.sqrt(np.nanmean(difference**2)) / recording.markers.sigma)


@pytest.mark.parametrize(
    ("kind", "hidden"),
    [
        ("bar", ("air_drag", "gravity")),
        ("two-part-bar", ("viscosity:eta=40",)),
        ("flower", ("mass_damping",)),
    ],
)
def test_the_truth_explains_the_data_to_the_noise(kind, hidden, tmp_path) -> None:
    made_of = small(kind, hidden)
    make_capture(made_of, tmp_path, measure_signal=False)
    capture = load_capture(tmp_path)
    assert capture.rest == made_of.shape.rest
    assert residual(capture, made_of, 1.4) == pytest.approx(1.0, abs=0.05)
    without = recipe(kind, seed=3, takes=made_of.takes)
    assert residual(capture, without, 1.4) > 1.05


def test_another_grid_agrees_with_the_truth_but_not_to_the_last_digit(tmp_path) -> None:
    made_of = small("two-part-bar", frames=12, noise_free=True)
    make_capture(made_of, tmp_path, measure_signal=False)
    apart = residual(load_capture(tmp_path), made_of, 1.1) * 1e-9
    assert 1e-7 < apart < 1e-3


def test_the_other_transfer_tells_the_same_story(tmp_path) -> None:
    options = {"frames": 12, "noise_free": True, "spacing_share": 1.0}
    first, other = (
        tracks(made(tmp_path / s, "two-part-bar", ("viscosity:eta=40",), simulator=s, **options)[1])
        for s in ("total-lagrangian", "mls")
    )
    moved, apart = np.abs(first - first[0]).max(), np.sqrt(np.mean((first - other) ** 2))
    assert moved > 5e-3
    # Particles converge by the first order: 0.42 mm here, 0.22 and 0.13 on grids of 0.62 and 0.4 shares.
    assert 1e-5 < apart < 0.05 * moved


def test_a_cause_outside_the_list_needs_a_transfer_that_feels_it(tmp_path) -> None:
    with pytest.raises(ValueError, match="'point_field': not with the simulator mls"):
        made(tmp_path, "bar", ("point_field",), simulator="mls")


def test_the_same_recipe_gives_the_same_numbers_and_another_seed_does_not(tmp_path) -> None:
    one, two, other = (
        made(tmp_path / name, "bar", ("air_drag",), seed=seed)[1]
        for name, seed in (("1", 4), ("2", 4), ("3", 5))
    )
    assert np.array_equal(tracks(one), tracks(two), equal_nan=True)
    assert not np.array_equal(one.sequences[0].markers.at, other.sequences[0].markers.at)
    assert one.known.density != other.known.density


def test_the_answer_states_what_is_hidden_and_how_large_it_is(tmp_path) -> None:
    hidden = ("air_drag:c_d=5", "length_scale:scale=0.01", "cubic_drag")
    result, capture = made(tmp_path, "two-part-bar", hidden, measure_signal=True)
    answer = json.loads((tmp_path / "answer.json").read_text())
    assert answer["hidden"] == ["air_drag", "length_scale", "unknown:cubic_drag"]
    assert answer["effects"]["air_drag"]["c_d"] == 5.0 and answer["effects"]["cubic_drag"]["part"] == "upper"
    assert answer["faults"] == {"length_scale": {"scale": 0.01}}
    assert answer["signal_over_noise"] == result.answer["signal_over_noise"] > 0.5
    for part in capture.parts:
        said = answer["parts"][part.name]
        assert said["mass"] == pytest.approx(said["rho"] * part.volume)
    assert capture.known.density == {"lower": answer["parts"]["lower"]["rho"]}


@pytest.mark.parametrize(("known", "said"), [("densities", 2), ("mass", 0)])
def test_what_the_capture_knows(known, said, tmp_path) -> None:
    made_of = small("two-part-bar", frames=8, known=known)
    make_capture(made_of, tmp_path)
    capture = load_capture(tmp_path)
    assert len(capture.known.density) == said
    assert capture.known.mass == (pytest.approx(made_of.mass) if known == "mass" else None)
    assert made_of.mass == pytest.approx(
        sum(p["mass"] for p in json.loads((tmp_path / "answer.json").read_text())["parts"].values())
    )


@pytest.mark.parametrize(
    ("hidden", "said"),
    [
        (("smoke",), "expected one of"),
        (("viscosity:speed=3",), "has no 'speed'"),
        (("viscosity:eta",), "not key=value"),
        (("viscosity:eta=much",), "expected a number"),
        (("stiffness_gradient:part=leaf",), "part 'leaf'"),
        (("viscosity", "viscosity"), "every name once"),
        (("time_offset:part=bar",), "has no part"),
    ],
)
def test_what_cannot_be_hidden_is_refused(hidden, said) -> None:
    with pytest.raises(ValueError, match=said):
        recipe("bar", hidden=hidden)


def test_takes_are_chosen_by_name() -> None:
    body = shape("bar")
    first, second = default_takes(body, frames=40, kinds=("rock", "turn"))
    assert [m.kind for m in first.motions] == ["rock", "turn"]
    assert (first.fit, first.predict, second.fit, second.predict) == ((0, 25), (25, 40), (0, 0), (0, 40))
    with pytest.raises(ValueError, match="expected one of shake"):
        default_takes(body, kinds=("jump",))


@pytest.mark.slow
def test_the_embedded_capture_is_made_once_and_holds_its_answer(tmp_path) -> None:
    folder = embedded_capture(tmp_path / "embedded")
    answer = json.loads((folder / "answer.json").read_text())
    assert answer["hidden"] == ["viscosity"]
    capture = load_capture(folder)
    assert [s.name for s in capture.sequences] == ["release", "shake"]
    written = (folder / "answer.json").stat().st_mtime_ns
    assert embedded_capture(folder).joinpath("answer.json").stat().st_mtime_ns == written


@pytest.mark.parametrize(
    ("kind", "simulator"), [("two-part-bar", "total-lagrangian"), ("bar", "finite-element")]
)
def test_progress_is_told_frame_by_frame_and_ends_at_the_whole(kind, simulator, tmp_path) -> None:
    made_of = small(kind, ("air_drag",), frames=6, simulator=simulator, spacing_share=2.0)
    told = []
    make_capture(made_of, tmp_path, report=lambda share, text: told.append((share, text)))
    shares = [share for share, _ in told]
    assert shares == sorted(shares) and shares[0] == 0.0 and shares[-1] == 1.0
    for text in ("a: 6 frames", "a: without what is hidden"):
        assert len({share for share, said in told if said.startswith(text)}) >= 3
