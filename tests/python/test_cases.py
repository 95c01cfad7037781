"""All of ../shared/cases, where they stand beside the repository: each gives what its expect.txt asks."""

from __future__ import annotations

import io
import json
import os
import shutil
import subprocess
import sys
import time
import zipfile
from pathlib import Path

import cv2
import numpy as np
import pytest

from command_example import SPACING, make_capture

CASES = Path(__file__).resolve().parents[3] / "shared" / "cases"
# Cases about stated errors, verdicts and formulas: they ask for hours, and what they ask is a number's.
STATISTICS = (
    "c3d_zero_dropouts", "diagnose_tether_bound", "false-formula-quant", "false-formula-survey", "fe-z",
    "gravity-0", "marker_labels_swapped", "null-dropped", "null-fps", "null-gtilt", "null-heavy",
    "null-jitter", "stiff_strip", "twang_start", "two-part-z", "verdict-by-stated-sigma",
)  # fmt: skip
# What a command says of a case that it is to refuse.
REFUSED = {
    "E-1e2": "from what is held",
    "fps-1e-6": "fps: is 1e-06",
    "fps-1e308": "fps: is 1e+308",
    "load-1e6-N": "loads[0].force: 1e+06 N",
    "markers-1e308": "marker 0 is measured 1.73e+308 m",
    "markers-explode": "is measured 563 m from the object",
    "npy-header-huge-shape": "a_markers.npz: position",
    "npz-claims-655TiB": "a_markers.npz: position",
    "thickness-0.02mm": "m thick",
    "twice_in_one_file": "stand there twice",
}
VIEWS = {
    "blender_transforms": (0, "8 views"),
    "masks_inverted": (2, "look inverted"),
    "ngp_is_fisheye": (0, "8 views"),
    "views_in_mm": (2, "units look off by 1000"),
    "views_same_name_in_folders": (0, "8 views"),
}
VIDEOS = (
    ("video_edit_list", "capture9", 0, "frog: moved"),
    ("video_edit_list", "capture12", 2, "has 9 frames; expected 12"),
    ("video_vfr_mkv", "capture", 2, "ms are usual"),
)
LIMIT = 120.0  # seconds, of a machine that is busy
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        not CASES.is_dir(), reason="the cases (../shared/cases beside the repository) are not here"
    ),
]


def case(name: str) -> Path:
    folder = CASES / name
    if not folder.is_dir():
        pytest.skip(f"the case {name} is not here")
    return folder


def mphygs(
    command: str, *arguments: object, where: Path | None = None, limit: float = 300.0
) -> tuple[int, str, str]:
    """Exit code, output and last line of a command in a process of its own."""
    words = [sys.executable, "-W", "ignore", "-m", "mphygs", command, *map(str, arguments)]
    done = subprocess.run(words, cwd=where, capture_output=True, text=True, timeout=limit, check=False)
    assert "Traceback" not in done.stderr
    lines = done.stderr.strip().splitlines() or [""]
    return done.returncode, done.stdout, lines[-1]


def test_every_case_is_looked_at() -> None:
    here = {path.name for path in CASES.iterdir() if path.is_dir()}
    videos = {name for name, *_ in VIDEOS}
    made = {
        "capture-name-traversal", "npz-bomb", "png-bomb", "out-stages-report-lost", "two-on-one-steps-json",
        "run-json-plugin-runs-code", "run-json-ranges-empty", "run-json-safety-text", "run-json-spacing-1e-9",
        "run-json-unknown-effect",
    }  # fmt: skip
    assert here <= {*REFUSED, *VIEWS, *videos, *made, *STATISTICS}


@pytest.mark.parametrize("name", REFUSED)
def test_captures_that_are_refused(name: str, tmp_path: Path) -> None:
    began = time.monotonic()
    code, out, line = mphygs("fit", case(name) / "capture", "--out", tmp_path / "run")
    assert (code, out) == (2, "") and REFUSED[name] in line and "expected" in line
    assert time.monotonic() - began < LIMIT and not (tmp_path / "run").exists()


@pytest.mark.parametrize("name", VIEWS)
def test_views(name: str, tmp_path: Path) -> None:
    code, words = VIEWS[name]
    options = ("--iterations", 25, "--longest", 64)
    found, out, line = mphygs("reconstruct", case(name) / "capture", "--out", tmp_path / "run", *options)
    assert found == code and words in out + line


@pytest.mark.parametrize(("name", "capture", "code", "words"), VIDEOS)
def test_videos(name: str, capture: str, code: int, words: str, tmp_path: Path) -> None:
    gaussians = ("--gaussians", case(name) / "gaussians.ply")
    found, out, line = mphygs("register", case(name) / capture, *gaussians, "--out", tmp_path / "run")
    assert found == code and words in out + line


def test_the_name_of_a_capture_leads_nowhere(tmp_path: Path) -> None:
    shutil.copytree(case("capture-name-traversal") / "capture", tmp_path / "w" / "capture")
    code, _, line = mphygs("fit", "capture", "--sequences", "a", where=tmp_path / "w")
    assert code == 0, line
    assert {path.name for path in tmp_path.iterdir()} == {"w"}
    assert {path.name for path in (tmp_path / "w").iterdir()} == {"capture", "runs"}


def test_a_bomb_of_arrays(tmp_path: Path) -> None:
    case("npz-bomb")
    make_capture(tmp_path / "capture")
    head = io.BytesIO()
    np.lib.format.write_array_header_1_0(
        head, {"descr": "<f8", "fortran_order": False, "shape": (24, 12, 1_400_000)}
    )
    with zipfile.ZipFile(tmp_path / "capture" / "swing_markers.npz", "w", zipfile.ZIP_DEFLATED) as archive:
        with archive.open(zipfile.ZipInfo("position.npy"), "w", force_zip64=True) as member:
            member.write(head.getvalue() + bytes(50_000_000))
    code, _, line = mphygs("fit", tmp_path / "capture", "--out", tmp_path / "run")
    assert code == 2 and "has shape (24, 12, 1400000)" in line


def test_a_bomb_of_a_picture(tmp_path: Path) -> None:
    case("png-bomb")
    source = case("ngp_is_fisheye") / "capture"
    bomb = cv2.imencode(".png", np.zeros((16_000, 16_000), np.uint8))[1].tobytes()
    for which in ("images/rest3.png", "masks/rest3.png"):
        folder = tmp_path / which.replace("/", "-")
        shutil.copytree(source, folder)
        (folder / "rest" / which).write_bytes(bomb)
        began = time.monotonic()
        code, _, line = mphygs("reconstruct", folder, "--out", tmp_path / "run")
        assert code == 2 and "is 16000 x 16000 pixels; expected 64 x 64" in line
        assert time.monotonic() - began < LIMIT


def test_files_of_somebody_else_stay(tmp_path: Path) -> None:
    case("out-stages-report-lost")
    (tmp_path / "mine" / "stages").mkdir(parents=True)
    (tmp_path / "mine" / "report.html").write_text("precious")
    make_capture(tmp_path / "capture")
    code, _, line = mphygs("fit", tmp_path / "capture", "--out", tmp_path / "mine")
    assert code == 2 and "has files that are not a run's" in line
    assert (tmp_path / "mine" / "report.html").read_text() == "precious"


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished run."""
    folder = tmp_path_factory.mktemp("finished")
    make_capture(folder / "capture")
    options = ("--spacing", SPACING, "--workers", 1)
    code, _, line = mphygs("fit", folder / "capture", "--out", folder / "run", *options)
    assert code == 0, line
    return folder / "run"


@pytest.mark.parametrize(
    "name", ["plugin-runs-code", "ranges-empty", "safety-text", "spacing-1e-9", "unknown-effect"]
)
def test_runs_of_somebody_else(name: str, finished: Path, tmp_path: Path) -> None:
    case(f"run-json-{name}")
    run = tmp_path / "run"
    shutil.copytree(finished, run)
    document = json.loads((run / "run.json").read_text())
    (run / "evil.py").write_text(f"open({str(tmp_path / 'ran')!r}, 'w').write('ran')")
    changes = {
        "plugin-runs-code": [lambda: document["options"].update(plugin=str(run / "evil.py"))],
        "ranges-empty": [lambda: document.update(ranges={})],
        "safety-text": [
            lambda: document["settings"].update(safety="x"),
            lambda: document["settings"].update(safety=1e9),
            lambda: document["settings"].update(safety=0.85, memory_budget="much"),
        ],
        "spacing-1e-9": [lambda: document["settings"].update(spacing=1e-9)],
        "unknown-effect": [lambda: document["belief"]["terms"].append({"name": "magic", "settings": {}})],
    }[name]
    for change in changes:
        change()
        (run / "run.json").write_text(json.dumps(document))
        began = time.monotonic()
        code, out, line = mphygs("compare", run, "--workers", 1)
        assert not (tmp_path / "ran").exists()
        if name == "plugin-runs-code":
            assert code == 0, "its model has no effect of the file's"
        else:
            assert (code, out) == (2, "") and "expected" in line and str(run) in line
            assert time.monotonic() - began < LIMIT


def test_two_commands_on_one_folder(tmp_path: Path) -> None:
    case("two-on-one-steps-json")
    make_capture(tmp_path / "capture")
    words = [sys.executable, "-m", "mphygs", "fit", tmp_path / "capture", "--out", tmp_path / "run"]
    words += ["--spacing", str(SPACING), "--workers", "1"]
    pair = [
        subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) for _ in range(2)
    ]
    ends = [(*process.communicate(timeout=300), process.returncode) for process in pair]
    codes = sorted(code for *_, code in ends)
    assert codes in ([0, 0], [0, 2]), ends
    for _, err, code in ends:
        if code == 2:
            assert f"on {os.uname().nodename}" in err and "writes there now" in err


@pytest.mark.parametrize("name", STATISTICS)
def test_cases_of_statistics_are_read_at_least(name: str) -> None:
    """What they ask of numbers and verdicts is asked where those are made."""
    from mphygs.capture.format import load_capture

    for folder in case(name).rglob("capture.json"):
        assert load_capture(folder.parent).sequences
