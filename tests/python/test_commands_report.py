"""The report: one file that shows everything, looked at in a headless browser."""

import json
import re
import shutil
import subprocess
from pathlib import Path

import cv2
import numpy as np
import pytest

from command_example import FRAMES, SPACING, answer, call, make_capture
from mphygs.command import plain
from mphygs.diagnose.force_features import Feature
from mphygs.diagnose.force_formula import Formula, Term
from mphygs.diagnose.force_readings import ForceSample
from mphygs.diagnose.force_regression import Explained
from mphygs.diagnose.missing_force import MissingForce
from mphygs.diagnose.missing_force_document import Unexplained, keep_missing_force
from mphygs.extend import __main__ as extend
from mphygs.fit import __main__ as fit
from mphygs.fit.run import load_run
from mphygs.report import __main__ as command
from mphygs.report.html import falling_errors, script_data, table
from mphygs.report.motion_data import LARGEST_FRAME_COUNT, motion_document, quantise, restore

SECTIONS = ("measured", "fitted", "prediction", "where", "ranking", "steps", "force", "commands")


@pytest.fixture(scope="module")
def reported(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("report")
    capture = make_capture(folder / "capture")
    elastic = answer(fit.main, capture, "--out", folder / "elastic", "--spacing", SPACING)["run"]
    viscous = answer(extend.main, elastic, "viscosity", "--out", folder / "viscous")["run"]
    return Path(answer(command.main, viscous)["report"])


def browser() -> str:
    found = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if found is None:
        pytest.skip("no Chromium here: apt-get install chromium")
    return found


def look(page: Path, *options: str, folder: Path) -> str:
    """What a headless browser says of a page, without any network."""
    arguments = ["--headless", "--no-sandbox", "--disable-gpu", "--virtual-time-budget=3000"]
    arguments += [f"--user-data-dir={folder}", "--host-resolver-rules=MAP * ~NOTFOUND"]
    command_line = [browser(), *arguments, *options, page.as_uri()]
    done = subprocess.run(command_line, capture_output=True, text=True, timeout=240)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_page_is_self_contained_and_tells_all(reported: Path) -> None:
    text = reported.read_text(encoding="utf-8")
    assert [m for m in re.findall(r'<section id="(\w+)"', text)] == list(SECTIONS)
    assert not re.search(r"""(src|href)=["'](?!data:)""", text), "nothing is loaded from elsewhere"
    assert "http://" not in text and "https://" not in text
    assert text.count("data:image/png;base64,") == 2
    assert "viscosity.eta" in text and "mphygs extend" in text
    assert "Verdict: missing; effects: viscosity." in text
    assert "Not diagnosed yet" in text


def test_browser_shows_the_turning_view(reported: Path, tmp_path: Path) -> None:
    dom = look(reported, "--dump-dom", folder=tmp_path / "profile")
    viewer = re.search(r'<div class="viewer" id="viewer"([^>]*)>', dom).group(1)
    assert 'data-ready="true"' in viewer
    assert int(re.search(r'data-drawn="(\d+)"', viewer).group(1)) > 500
    assert 'max="' + str(FRAMES - 1) + '"' in dom
    assert "frame 0, 0.000 s, fitted" in dom
    assert dom.count("<option") == 2


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
    term = Term(0, "e_z", "m/s^2", 2.0, 0.1, 0.95, ("v",))
    explained = Explained(Formula((term,), 0.9, ()), (Feature("uniform", None, (2.0,)),))
    missing = MissingForce(load_run(folder).belief, {}, 900.0, 100.0, 100, 1.0)
    found = Unexplained(missing, (sample,), explained, ("bar",))
    keep_missing_force(found, folder)
    diagnosis = {
        "verdict": "unknown", "effects": [], "ranking": [], "missing_force": found.document(), "advice": "",
    }  # fmt: skip
    (folder / "diagnosis.json").write_text(json.dumps(plain(diagnosis)))
    out = folder / "force.html"
    answer(command.main, folder, "--out", out)
    keep_missing_force(None, folder)
    (folder / "diagnosis.json").unlink()
    return out


def test_missing_force_is_told_with_readings_and_formula(with_force: Path) -> None:
    text = with_force.read_text(encoding="utf-8")
    section = text[text.index('<section id="force">') : text.index('<section id="commands">')]
    for words in ("2 N/kg (rms)", "dissipative", "formula [N/kg]: 2 e_z", "not told apart from v"):
        assert words in section, words
    assert text.count('"arrows":') == 1, "of one of the two sequences"
    assert '"arrow_count": 2' in text


def test_browser_draws_the_missing_force_over_time(with_force: Path, tmp_path: Path) -> None:
    text = with_force.read_text(encoding="utf-8")
    for frame, count in ((5, 2), (20, 0)):
        script = (
            "<script>const s = document.querySelector('[data-role=time]'); "
            f"s.value = '{frame}'; s.dispatchEvent(new Event('input'));</script></body>"
        )
        page = tmp_path / f"{frame}.html"
        page.write_text(text.replace("</body>", script), encoding="utf-8")
        dom = look(page, "--dump-dom", folder=tmp_path / "profile")
        drawn = re.search(r'<div class="viewer" id="viewer"[^>]*data-arrows="(\d+)"', dom)
        assert drawn.group(1) == str(count)


def test_browser_shows_points_and_moves_with_time(reported: Path, tmp_path: Path) -> None:
    moved = tmp_path / "moved.html"
    text = reported.read_text(encoding="utf-8")
    script = (
        "<script>const s = document.querySelector('[data-role=time]'); s.value = '5';"
        "s.dispatchEvent(new Event('input'));</script></body>"
    )
    moved.write_text(text.replace("</body>", script), encoding="utf-8")
    images = []
    for page in (reported, moved):
        shot = tmp_path / f"{page.stem}.png"
        look(page, f"--screenshot={shot}", "--window-size=1200,1500", folder=tmp_path / "profile")
        images.append(cv2.imread(str(shot)).astype(int))
    # Canvas of the page's middle: the green of the surface is there, and elsewhere a few frames later.
    green = [(image[..., 1] > image[..., 0] + 8) & (image[..., 1] > image[..., 2] + 8) for image in images]
    assert green[0].sum() > 2000
    assert (green[0] ^ green[1]).sum() > 0.1 * green[0].sum()


def test_positions_survive_packing() -> None:
    values = np.random.default_rng(0).uniform(-0.1, 0.3, (50, 3))
    values[7] = np.nan
    low, high = np.full(3, -0.1), np.full(3, 0.3)
    back = restore(quantise(values, low, high), low, high)
    assert np.isnan(back[7]).all()
    assert np.nanmax(np.abs(back - values)) < 1e-5


def test_long_motions_are_thinned_out() -> None:
    frames = 3 * LARGEST_FRAME_COUNT
    motion = motion_document(
        fps=100.0,
        measured=np.zeros((frames, 2, 3)),
        predicted=np.zeros((frames, 2, 3)),
        surface=np.zeros((frames, 4, 3)),
        surface_part=np.zeros(4, int),
        normals=np.zeros((4, 3)),
        fit=(0, 9),
    )
    assert motion["frames"][:3] == [0, 3, 6] and len(motion["frames"]) == LARGEST_FRAME_COUNT
    with pytest.raises(ValueError, match="motion: measured"):
        motion_document(
            fps=1.0, measured=np.zeros((2, 1, 3)), predicted=np.zeros((2, 2, 3)), surface=np.zeros((2, 4, 3)),
            surface_part=np.zeros(4, int), normals=np.zeros((4, 3)), fit=(0, 1),
        )  # fmt: skip


def test_pieces_of_html_are_safe_and_complete() -> None:
    assert "&lt;b&gt;" in table(["<b>"], [["<b>", 1.5]]) and "1.5" in table(["a"], [[1.5]])
    assert "</script>" not in script_data({"name": "</script>"})
    chart = falling_errors(["before", "+ a"], {"one": [3.0, 1.1], "two": [2.0, None]})
    assert chart.count("<circle") == 3 and "1.10" in chart
    heights = [float(y) for y in re.findall(r'cy="([\d.]+)"', chart)]
    assert heights[0] < heights[2] < heights[1], "larger errors stand higher"


def test_refuses_what_is_damaged_in_one_line(reported: Path, tmp_path: Path) -> None:
    code, _, err = call(command.main, tmp_path)
    assert code == 2 and "is not a run" in err
    steps = reported.parent / "steps.json"
    kept = json.loads(steps.read_text())
    diagnosis = reported.parent / "diagnosis.json"
    for path, text, words in (
        (steps, "{", "steps.json: is not JSON"),
        (steps, "[]", "steps.json: has no 'steps'"),
        (diagnosis, "[]", "diagnosis.json: has no 'verdict'"),
    ):
        path.write_text(text)
        code, _, err = call(command.main, reported.parent, "--out", tmp_path / "x.html")
        steps.write_text(json.dumps(kept))
        assert code == 2 and words in err and err.count("\n") == 1
    diagnosis.unlink()
    # The page's place is looked at before the work is done.
    code, _, err = call(command.main, reported.parent, "--out", tmp_path)
    assert code == 2 and "is a folder; expected the name of a file" in err and err.count("\n") == 1
