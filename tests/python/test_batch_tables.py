"""The tables of a batch and its view: one row a run, sorted by any column."""

import csv
import io
import json
from pathlib import Path

import pytest

from batch_example import task
from mphygs.batch.dispatch import Running
from mphygs.batch.summary import Row, csv_text, row_of
from mphygs.batch.summary_page import summary_page
from mphygs.batch.work import Outcome
from mphygs.commands.batch_view import BatchView
from mphygs.commands.console import Console
from page_driver import opened


def error(rms: float, count: int = 10) -> dict[str, float]:
    return {"rms": rms, "max": 2 * rms, "rms_over_sigma": 1e3 * rms, "count": count}


STEPS = {
    "steps": [
        {"sequences": {"a": {"fit": error(1.0)}}, "parameters": {}},
        {
            "sequences": {
                "a": {"fit": error(3e-3, 30), "predict": None},
                "b": {"fit": error(1e-3), "predict": error(2e-3)},
            },
            "parameters": {
                "bar.youngs_modulus": {"value": 2.5e5, "std": 1e3, "unit": "Pa", "determined": True},
                "drag.c": {"value": 0.1, "std": 0.2, "unit": "1/s", "determined": False},
            },
        },
    ],
    "verdict": "missing",
    "effects": ["drag"],
}


def test_the_row_of_a_run_pools_its_sequences() -> None:
    row = row_of(task("a", seed=3), Outcome(0, "", STEPS, 12.0))
    assert (row.state, row.verdict, row.effects, row.seed) == ("done", "missing", ("drag",), 3)
    assert row.errors["fit"]["rms"] == pytest.approx((0.75 * 9e-6 + 0.25 * 1e-6) ** 0.5)
    assert row.errors["fit"]["max"] == 6e-3 and row.errors["predict"]["rms"] == pytest.approx(2e-3)
    assert row.loose == ["drag.c"]


def test_the_row_of_a_diagnosis_and_of_a_comparison() -> None:
    found = {
        "verdict": "missing", "effects": ["drag"], "path": [{"fitted": 3.0, "unseen": None}, {"fitted": 1.0}],
        "table": [
            {"effect": "drag", "estimate": {"c": 0.5}, "std": {"c": 0.1}, "struck": None},
            {"effect": "tether", "estimate": {"k": 2.0}, "std": {"k": 0.1}, "struck": "why"},
        ],
    }  # fmt: skip
    row = row_of(task("a"), Outcome(0, "", found, 1.0))
    assert row.parameters == {"drag.c": {"value": 0.5, "std": 0.1}}
    assert row.errors == {"fit": {"rms": None, "max": None, "rms_over_sigma": 3.0}}
    held_against = {"sequences": {"a": {"fit": error(1e-3), "predict": None, "all": error(1e-3)}}}
    for adequate, verdict in ((True, "adequate"), (False, "more than noise")):
        row = row_of(task("a"), Outcome(0, "", held_against | {"adequate": adequate}, 1.0))
        assert (row.verdict, row.errors["fit"]["rms"]) == (verdict, 1e-3)


def rows() -> list[Row]:
    found = [row_of(task("first", seed=10), Outcome(0, "", STEPS, 12.0))]
    less = json.loads(json.dumps(STEPS)) | {"verdict": "adequate", "effects": []}
    less["steps"][1]["parameters"]["bar.youngs_modulus"]["value"] = 9.0e4
    found.append(row_of(task("second", seed=9), Outcome(0, "", less, 3.0)))
    line = 'x: "<b>" is no, number; expected one'
    return [*found, row_of(task("third", seed=100), Outcome(2, line, None, 1.0)), row_of(task("4"), None)]


def test_the_table_as_csv_has_every_number_to_its_last_digit() -> None:
    first, second, third, last = csv.DictReader(csv_text(rows()).splitlines())
    assert float(first["fit_rms_m"]) == rows()[0].errors["fit"]["rms"]
    assert (first["bar.youngs_modulus [Pa]"], second["bar.youngs_modulus [Pa]"]) == ("250000.0", "90000.0")
    assert first["bar.youngs_modulus std [Pa]"] == "1000.0" and first["not determined"] == "drag.c"
    assert (third["state"], third["line"]) == ("failed", 'x: "<b>" is no, number; expected one')
    assert (last["state"], last["fit_rms_m"]) == ("waiting", "")


def test_the_page_sorts_by_any_column_without_a_network(tmp_path: Path) -> None:
    text = summary_page("two & more", "mphygs batch", rows(), folders=True)
    assert "http" not in text.replace("http-equiv", "") and "<b>&quot;" not in text and "&lt;b&gt;" in text
    (tmp_path / "summary.html").write_text(text, encoding="utf-8")
    with opened((tmp_path / "summary.html").as_uri()) as shown:

        def order_of() -> list[str]:
            return shown.locator("#runs tbody tr td:first-child").all_inner_texts()

        def click(head: str) -> None:
            shown.get_by_role("button", name=head, exact=True).click()

        assert order_of() == ["first", "second", "third", "4"]
        click("seed")
        assert order_of() == ["second", "first", "third", "4"]
        click("seed")
        assert order_of() == ["third", "first", "second", "4"]
        click("bar.youngs_modulus")
        assert order_of() == ["second", "first", "third", "4"]
        click("verdict")
        assert order_of()[:2] == ["second", "first"]
        click("run")
        assert order_of() == ["4", "first", "second", "third"]
        sorts = shown.evaluate("[...document.querySelectorAll('#runs th')].map(h => h.ariaSort)")
        assert sorts.count("ascending") == 1 and sorts.count("none") == len(sorts) - 1
        colour = shown.evaluate("getComputedStyle(document.querySelector('tr.failed td')).color")
        assert colour == "rgb(213, 94, 0)"


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.mark.parametrize("stream", [io.StringIO(), Terminal()])
def test_all_runs_are_shown_in_one_view(
    stream: io.StringIO, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TERM", "xterm")
    view = BatchView(Console(stream), before=1, total=4)
    running = []
    for name, said in (("bar", "reading\n[ 12 %, 3 s] coarse\n"), ("longer", "")):
        one = task(name, tmp_path)
        one.log.parent.mkdir(exist_ok=True)
        one.log.write_text(said)
        running.append(Running(one, "a", 1, None))
    view.look([], 0)
    first = stream.getvalue()
    assert first == "1 of 4 done, 0 under way on 0 workers: waiting for one\n"
    view.ended("bar: missing", failed=True)
    view.look(running, 2)
    shown = stream.getvalue()[len(first) :]
    if stream.isatty():
        assert shown.startswith("\x1b[1F\x1b[J[ 33 %, ")
        assert shown.endswith(
            "2 of 4 done, 1 failed, 2 under way on 2 workers\n  bar     [ 12 %, 3 s] coarse\n  longer  \n"
        )
    else:
        assert shown.startswith("[ 33 %, ") and shown.count("\n") == 1
    assert "2 of 4 done, 1 failed; bar: missing\n" in shown
