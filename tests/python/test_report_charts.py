"""What the charts of a report show, and the sentence it begins with."""

import numpy as np
import pytest

from mphygs.report.charts import (
    budget_chart,
    correlation_chart,
    correlations_of,
    fall_chart,
    intervals_chart,
    ranking_chart,
    ranking_rows,
)
from mphygs.report.evidence import two_errors
from mphygs.report.film_frames import Filmed
from mphygs.report.verdict import pooled, verdict_sentence


def errors(ratio: float, count: int = 100) -> dict:
    return {"rms": 1e-4 * ratio, "max": 1e-3, "rms_over_sigma": ratio, "count": count}


def test_fall_shows_every_model_and_both_floors() -> None:
    before, after = {"fit": errors(3.0), "predict": errors(5.0)}, {"fit": errors(1.0), "predict": None}
    steps = [{"s": before}, {"s": after}]
    chart = fall_chart(["elastic", "<b>"], steps, {"noise": 3e-4, "discretisation": 4e-4, "physics": 0.0})
    fitted, unseen = chart["data"]
    assert fitted["y"] == [3.0, 1.0] and unseen["y"] == [5.0] and unseen["x"] == [0]
    assert fitted["line"]["dash"] != unseen["line"]["dash"], "told apart without colours"
    floors = [shape["y0"] for shape in chart["layout"]["shapes"]]
    assert floors == pytest.approx([1.0, 5.0 / 3.0])
    assert chart["layout"]["xaxis"]["ticktext"] == ["elastic", "&lt;b&gt;"]


def diagnosis() -> dict:
    entry = {"kind": "smooth", "p_value": 0.0, "estimate": {"eta": 60.0}, "std": {"eta": 2.0}, "reason": "",
             "confounded_with": []}  # fmt: skip
    return {
        "effects": ["viscosity"],
        "ranking": [
            entry | {"effect": "viscosity", "statistic": 900.0, "refitted": 950.0},
            entry | {"effect": "fibre", "statistic": 3.0, "refitted": None, "reason": "absorbed"},
        ],
    }


def test_ranking_takes_what_the_run_tells() -> None:
    plain = ranking_rows(diagnosis())
    assert [row["predicted"] for row in plain] == [900.0, 3.0] and plain[0]["gain"] is None
    chart = ranking_chart(plain, ["viscosity"])
    bars, refits = chart["data"]
    assert bars["y"] == ["fibre", "viscosity"] and refits["x"] == [950.0] and "xaxis2" not in chart["layout"]
    assert bars["marker"]["pattern"]["shape"] == ["/", ""] and chart["layout"]["xaxis"]["type"] == "log"
    assert "eta = 60 ± 2" in bars["customdata"][1][0] and "struck off: absorbed" in bars["customdata"][0][0]
    rich = diagnosis() | {
        "table": [
            {"effect": "viscosity", "predicted_drop": 900.0, "drop": 960.0, "gain": 40.0, "gain_se": 5.0,
             "numbers": 1, "struck": None},
            {"effect": "wind", "predicted_drop": 20.0, "drop": None, "gain": None, "gain_se": None,
             "numbers": 3, "struck": "promises too little to be refitted"},
        ]
    }  # fmt: skip
    rows = ranking_rows(rich)
    assert [(r["effect"], r["drop"], r["gain"], r["error"]) for r in rows] == [
        ("viscosity", 960.0, 40.0, 5.0), ("wind", None, None, None), ("fibre", None, None, None),
    ]  # fmt: skip
    assert [r["struck"] for r in rows] == ["", "promises too little to be refitted", "absorbed"]
    second = [row | {"struck": "leaves more"} for row in rich["table"]]
    assert [r["struck"] for r in ranking_rows(rich | {"table": second})][:2] == ["", "leaves more"]
    bars, refits, gains = ranking_chart(rows, [])["data"]
    assert refits["x"] == [960.0] and gains["x"] == [None, None, 40.0] and gains["xaxis"] == "x2"
    assert gains["error_x"]["array"] == [0.0, 0.0, 5.0]
    assert "gain on unseen frames 40 ± 5" in bars["customdata"][2][0]


def test_intervals_and_correlations_are_those_of_the_covariance() -> None:
    entry = {"value": 200.0, "std": 10.0, "unit": "Pa", "determined": True}
    chart = intervals_chart({"a": entry, "b": entry | {"std": None}})
    assert chart["data"][0]["error_x"]["array"] == [10.0] and chart["data"][0]["y"] == ["a"]
    assert intervals_chart({"b": entry | {"std": None}}) is None
    covariance = np.array([[4.0, -3.0, 0.0], [-3.0, 9.0, 0.0], [0.0, 0.0, 0.0]])
    correlation = correlations_of(["a", "b", "c"], covariance)
    assert correlation[0, 1] == pytest.approx(-0.5) and np.isnan(correlation[2]).all()
    assert correlation_chart(["a", "b", "c"], correlation)["data"][0]["z"][0] == [1.0, -0.5, None]
    assert correlation_chart(["a"], correlation[:1, :1]) is None


def test_two_errors_of_a_logarithm_stay_above_zero() -> None:
    assert two_errors(10.0, 1.0, log=False) == [8.0, 12.0] and two_errors(1.0, None, log=True) == []
    low, high = two_errors(10.0, 10.0, log=True)
    assert 0.0 < low and low * high == pytest.approx(100.0) and high == pytest.approx(10.0 * np.exp(2.0))


def test_budget_adds_up_in_squares() -> None:
    chart = budget_chart({"noise": 3e-4, "discretisation": 0.0, "physics": 4e-4})
    assert [trace["x"][0] for trace in chart["data"]] == pytest.approx([36.0, 0.0, 64.0])


@pytest.mark.parametrize(
    ("verdict", "effects", "words"),
    [
        ("missing", ["viscosity"], "bar moves with viscosity, which its model had lacked: the error falls"),
        ("measurement", ["time_offset"], "The measurement of bar is at fault: time_offset, corrected"),
        ("unknown", [], "No known effect explains all of how bar moves"),
        ("adequate", [], "Nothing is missing from the model of bar"),
    ],
)
def test_the_sentence_says_what_was_found(verdict: str, effects: list[str], words: str) -> None:
    now = {"sequences": {"s": {"fit": errors(1.0), "predict": errors(1.5)}}, "adequate": True, "p_value": 0.5}
    before = {"sequences": {"s": {"fit": errors(3.0), "predict": errors(6.0)}}}
    steps = {"steps": [before, now], "verdict": verdict, "effects": effects}
    told = verdict_sentence("bar", now, steps, None)
    assert told.startswith(words) and "from 6.00 to 1.50 on frames that no fit has seen" in told
    assert pooled({"a": {"fit": errors(1.0)}, "b": {"fit": errors(3.0, 300)}}, "fit") == pytest.approx(7**0.5)


def test_films_are_thinned_to_their_budget() -> None:
    generator = np.random.default_rng(0)
    film = Filmed((0, 4), list(range(12)))
    film.photographs = film.drawn = [
        generator.integers(0, 255, (64, 64, 3), dtype=np.uint8) for _ in range(12)
    ]
    whole, small = film.document("f", 1_000_000), film.document("f", 40_000)
    assert whole["frames"] == list(range(12)) and whole["fitted"][:5] == [True] * 4 + [False]
    assert 3 <= len(small["frames"]) < 12 and sum(map(len, small["seen"] + small["drawn"])) <= 40_000
