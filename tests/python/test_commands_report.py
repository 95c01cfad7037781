"""The report: one file that shows everything, looked at in a headless browser."""

import itertools
import json
import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from playwright.sync_api import Page

from command_example import FRAMES, SPACING, answer, call, make_capture
from mphygs.capture.json_values import plain
from mphygs.commands import extend, fit
from mphygs.commands import report as command
from mphygs.diagnose.force_features import Feature
from mphygs.diagnose.force_formula import Formula, FormulaTerm
from mphygs.diagnose.force_readings import ForceSample
from mphygs.diagnose.force_regression import Explained
from mphygs.diagnose.missing_force import MissingForce
from mphygs.diagnose.missing_force_document import Unexplained, keep_missing_force
from mphygs.fit.run import load_run
from mphygs.report.evidence import ranking
from mphygs.report.html import html_table, script_data
from page_driver import opened

SECTIONS = (
    "fall", "object", "moments", "ranking", "parameters", "budget", "next", "measured", "commands",
)  # fmt: skip
LARGEST_PAGE = 5_000_000
# A candidate as a diagnosis tells it.
DRAG = {
    "effect": "air_drag", "kind": "smooth", "statistic": 120.0, "p_value": 1e-9, "estimate": {"c_d": 1.2},
    "std": {"c_d": 0.1}, "confounded_with": ["wind"], "reason": "", "refitted": 90.0,
    "detectable": {"c_d": 0.3},
}  # fmt: skip


@pytest.fixture(scope="module")
def reported(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("report")
    capture = make_capture(folder / "capture")
    elastic = answer(fit.main, capture, "--out", folder / "elastic", "--spacing", SPACING)["run"]
    viscous = answer(extend.main, elastic, "viscosity", "--out", folder / "viscous")["run"]
    return Path(answer(command.main, viscous)["report"])


def shown(page: Page, name: str) -> str:
    """What the scene says of itself."""
    return page.evaluate(f"document.getElementById('scene').dataset.{name}")


def move_slider(page: Page, value: int) -> None:
    slider = page.locator("#scene [data-role=time]")
    slider.evaluate(f"s => {{ s.value = '{value}'; s.dispatchEvent(new Event('input')); }}")


def test_page_is_self_contained_and_tells_all(reported: Path) -> None:
    text = reported.read_text(encoding="utf-8")
    assert reported.stat().st_size < LARGEST_PAGE
    assert [m for m in re.findall(r'<section id="(\w+)"', text)] == list(SECTIONS)
    assert not re.search(r"""(src|href)=["'](?!data:)""", text), "nothing is loaded from elsewhere"
    assert "http://" not in text and "https://" not in text
    assert "viscosity.eta" in text and "mphygs extend" in text
    sentence = re.search(r'id="verdict">([^<]*)<br>', text).group(1)
    before, after = map(float, re.search(r"falls from ([\d.]+) to ([\d.]+) times", sentence).groups())
    assert sentence.startswith("tiny moves with viscosity, which its model had lacked")
    assert before > 1.3 and 0.8 < after < 1.2
    assert "Verdict: missing; effects: viscosity." in text and "Not diagnosed yet" in text


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_reader_moves_flips_and_hovers(reported: Path, scheme: str) -> None:
    with opened(reported.as_uri(), scheme=scheme) as page:
        assert page.locator("#scene [data-role=sequence] option").all_inner_texts() == ["swing", "other"]
        assert shown(page, "frame") == "0" and "fitted" in page.locator("#scene .label").inner_text()
        move_slider(page, FRAMES - 1)
        said = page.locator("#scene .label").inner_text()
        assert shown(page, "frame") == str(FRAMES - 1) and "unseen" in said and "predicted, after" in said
        where = "document.querySelector('#scene .canvas').data[0].z.slice(0, 400)"
        late = np.array(page.evaluate(where))
        page.get_by_label("measured", exact=True).check()
        measured = np.array(page.evaluate(where))
        assert shown(page, "shape") == "measured"
        assert 0.0 < np.abs(measured - late).max() < 1.0, "as far as noise goes [mm]"
        after = float(shown(page, "rms"))
        page.get_by_label("before", exact=True).check()
        assert float(shown(page, "rms")) > 2 * after
        page.get_by_label("predicted", exact=True).check()
        without = np.array(page.evaluate(where))
        assert np.abs(without - late).max() > 2 * np.abs(measured - late).max()
        move_slider(page, 2)
        assert np.abs(np.array(page.evaluate(where)) - without).max() > 0.5
        page.locator("#scene [data-role=sequence]").select_option("other")
        assert "unseen" in page.locator("#scene .label").inner_text()
        # A point of the fall's line tells its value.
        page.locator("#chart-fall").scroll_into_view_if_needed()
        point = page.locator("#chart-fall .scatterlayer .point").first.bounding_box()
        page.mouse.move(point["x"] + point["width"] / 2, point["y"] + point["height"] / 2)
        told = page.locator("#chart-fall .hoverlayer").text_content()
        assert "elasticity alone" in told and "times the noise" in told
        ink = page.evaluate("document.getElementById('chart-fall').layout.font.color")
        assert (ink == "#e8eaed") is (scheme == "dark")


def test_all_of_the_box_is_in_view_and_no_marker_sinks_into_the_skin(reported: Path) -> None:
    eye = "Object.values(document.querySelector('#scene .canvas').layout.scene.camera.eye)"
    dots = """(() => { const d = document.querySelector('#scene .canvas').data[1], p = scene.predicted(
        scene.motion().models.at(-1), scene.at()); return [0, 1, 2].map(
        a => d["xyz"[a]].map((v, k) => v - 1000 * p[3 * k + a])); })()"""
    with opened(reported.as_uri()) as page:
        ratio = np.array(
            page.evaluate("Object.values(document.querySelector('#scene .canvas').layout.scene.aspectratio)")
        )
        view = page.evaluate("document.querySelector('#scene .canvas').getBoundingClientRect().toJSON()")
        from_home = np.array(page.evaluate(eye))
        back = from_home / np.linalg.norm(from_home)
        right = np.cross([0.0, 0.0, 1.0], back)
        right /= np.linalg.norm(right)
        corners = 0.5 * ratio * np.array(list(itertools.product((-1, 1), repeat=3)))
        depth = np.linalg.norm(from_home) - corners @ back
        across = np.abs(corners @ right) / depth / np.tan(np.pi / 8) * view["height"] / view["width"]
        up = np.abs(corners @ np.cross(back, right)) / depth / np.tan(np.pi / 8)
        assert 0.8 < max(across.max(), up.max()) < 0.95
        assert (back @ np.array(page.evaluate(dots)) > 0.0).all()
        page.locator("div.scene").scroll_into_view_if_needed()
        box = page.locator("#scene .canvas").bounding_box()
        x, y = box["x"] + 0.5 * box["width"], box["y"] + 0.5 * box["height"]
        page.mouse.move(x, y)
        page.mouse.down()
        page.mouse.move(x + 150, y - 80, steps=5)
        page.mouse.up()
        # Where it is looked at from has changed, and the markers with it.
        page.wait_for_function(f"Math.abs({eye}[2] - {from_home[2]}) > 0.5")
        page.wait_for_timeout(500)
        now = np.array(page.evaluate(eye))
        assert (now @ np.array(page.evaluate(dots)) > 0.0).all()


def test_map_of_errors_is_of_the_right_marker_and_goes_to_its_frame(reported: Path) -> None:
    with opened(reported.as_uri()) as page:
        maps = page.evaluate("document.getElementById('chart-heat').data.map(d => d.z)")
        before, after = (np.array(z, float) for z in maps)
        assert before.shape == after.shape == (12, FRAMES)
        assert np.isnan(before).sum() == 1, "the one that was not measured"
        assert np.nanmean(before**2) > 2 * np.nanmean(after**2)
        page.locator("#chart-heat").scroll_into_view_if_needed()
        box = page.locator("#chart-heat .nsewdrag").first.bounding_box()
        page.mouse.move(box["x"] + 0.5 * box["width"], box["y"] + 0.5 * box["height"])
        page.mouse.click(box["x"] + 0.5 * box["width"], box["y"] + 0.5 * box["height"])
        page.wait_for_function("document.getElementById('scene').dataset.frame !== '0'")
        assert abs(int(shown(page, "frame")) - FRAMES // 2) <= 1


def test_print_is_light_complete_and_shows_the_object(reported: Path, tmp_path: Path) -> None:
    with opened(reported.as_uri(), scheme="dark") as page:
        page.evaluate("""window.addEventListener('beforeprint', () => { window.inPrint = [
            document.querySelectorAll('details:not([open])').length,
            document.getElementById('chart-fall').layout.font.color]; })""")
        content = page.pdf(path=tmp_path / "page.pdf", format="A4")
        assert page.evaluate("window.inPrint") == [0, "#1c2024"]
        assert page.evaluate("document.querySelectorAll('details[open]').length") == 0
        assert content.startswith(b"%PDF") and len(content) > 30_000


@pytest.fixture(scope="module")
def with_force(reported: Path) -> Path:
    """The report of a run with a missing force: 2 N/kg up on two places in frames 1 to 15 of `swing`."""
    folder = reported.parent
    frames = np.arange(1, 16)
    place = np.tile([[0.02, 0.006, 0.012], [0.05, 0.006, 0.012]], (15, 1, 1))
    force = np.zeros((15, 2, 3))
    force[..., 2] = 2.0
    sample = ForceSample(
        "swing", force, place, -0.1 * force, np.array([1e-3, 1e-3]), np.array([0, 0]), ("bar",), frames
    )
    term = FormulaTerm(0, "e_z", "m/s^2", 2.0, 0.1, 0.95, ("v",))
    explained = Explained(Formula((term,), 0.9, ()), (Feature("uniform", None, (2.0,)),))
    missing = MissingForce(load_run(folder).belief, {}, 900.0, 100.0, 100, 1.0)
    found = Unexplained(missing, (sample,), explained, ("bar",))
    keep_missing_force(found, folder)
    diagnosis = {
        "verdict": "unknown", "effects": [], "ranking": [DRAG], "advice": "",
        "missing_force": found.document(),
    }  # fmt: skip
    (folder / "diagnosis.json").write_text(json.dumps(plain(diagnosis)))
    out = folder / "force.html"
    answer(command.main, folder, "--out", out)
    keep_missing_force(None, folder)
    (folder / "diagnosis.json").unlink()
    return out


def test_what_was_found_of_the_model_before_is_told(reported: Path) -> None:
    """`diagnose elastic`, `extend elastic viscosity --out viscous`, `report viscous`."""
    viscous = load_run(reported.parent)
    assert command.diagnosis_before(viscous) is None
    elastic = reported.parent.parent / "elastic"
    diagnosis = {"verdict": "missing", "effects": ["air_drag"], "ranking": [DRAG], "advice": "add it"}
    (elastic / "diagnosis.json").write_text(json.dumps(diagnosis))
    told = command.diagnosis_before(viscous)
    other = command.diagnosis_before(replace(viscous, digest="of another capture"))
    (elastic / "diagnosis.json").unlink()
    assert told == diagnosis and other is None
    figures: list[dict] = []
    text = ranking(SimpleNamespace(diagnosis=None, diagnosis_before=told), figures)
    assert "the model before" in text and "air_drag" in text and len(figures) == 1


def test_missing_force_is_told_with_readings_and_formula(with_force: Path) -> None:
    text = with_force.read_text(encoding="utf-8")
    section = text[text.index('<section id="force">') : text.index('<section id="next">')]
    for words in ("2 N/kg (rms)", "dissipative", "formula [N/kg]: 2 e_z", "not told apart from v"):
        assert words in section, words
    assert text.count('"arrows":') == 1, "of one of the two sequences"
    assert '"arrow_count": 2' in text


def test_a_bar_tells_its_candidate(with_force: Path) -> None:
    with opened(with_force.as_uri()) as page:
        page.locator("#chart-ranking").scroll_into_view_if_needed()
        box = page.locator("#chart-ranking .barlayer .point path").first.bounding_box()
        page.mouse.move(box["x"] + 0.5 * box["width"], box["y"] + 0.5 * box["height"])
        told = page.locator("#chart-ranking .hoverlayer").text_content()
        for words in ("air_drag: 120", "c_d = 1.2 ± 0.1", "not told apart from wind"):
            assert words in told, told


def test_browser_draws_the_missing_force_over_time(with_force: Path) -> None:
    with opened(with_force.as_uri()) as page:
        for frame, count in ((5, 2), (20, 0)):
            move_slider(page, frame)
            assert shown(page, "arrows") == str(count)
        move_slider(page, 5)
        up = page.evaluate("document.querySelector('#scene .canvas').data.find(d => d.type === 'cone').w")
        assert np.allclose(up, 1.0)
        page.locator("#scene [data-role=force]").uncheck()
        assert shown(page, "arrows") == "0"


def test_pieces_of_html_are_safe_and_complete() -> None:
    assert "&lt;b&gt;" in html_table(["<b>"], [["<b>", 1.5]]) and "1.5" in html_table(["a"], [[1.5]])
    assert "</script>" not in script_data({"name": "</script>"})


def test_refuses_what_is_damaged_in_one_line(reported: Path, tmp_path: Path) -> None:
    code, _, err = call(command.main, tmp_path)
    assert code == 2 and "is not a run" in err
    steps = reported.parent / "steps.json"
    kept = json.loads(steps.read_text())
    diagnosis = reported.parent / "diagnosis.json"
    for path, text, words in (
        (steps, "{", "steps.json: line 1 column 2: "),
        (steps, "[]", "steps.json: is a list; expected an object"),
        (diagnosis, "[]", "diagnosis.json: is a list; expected an object"),
    ):
        path.write_text(text)
        code, _, err = call(command.main, reported.parent, "--out", tmp_path / "x.html")
        steps.write_text(json.dumps(kept))
        assert code == 2 and words in err and err.count("\n") == 1
    diagnosis.unlink()
    # The page's place is looked at before the work is done.
    code, _, err = call(command.main, reported.parent, "--out", tmp_path)
    assert code == 2 and "is a folder; expected the name of a file" in err and err.count("\n") == 1
