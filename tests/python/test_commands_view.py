"""The live viewer: the page, the motion that follows a number, and what it refuses."""

import json
import re
import signal
import subprocess
import sys
import urllib.request
from pathlib import Path

import numpy as np
import pytest

from command_example import SPACING, answer, call, make_capture
from mphygs import view
from mphygs.fit import __main__ as fit
from mphygs.fit.run import load_run
from mphygs.report.live import moved_belief, reach_of


@pytest.fixture(scope="module")
def fitted(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("view")
    capture = make_capture(folder / "capture")
    return Path(answer(fit.main, capture, "--out", folder / "run", "--spacing", SPACING)["run"])


def post(address: str, document: object) -> dict:
    request = urllib.request.Request(address + "motion", json.dumps(document).encode(), method="POST")
    with urllib.request.urlopen(request, timeout=120) as reply:
        return json.loads(reply.read())


def test_serves_the_page_and_follows_a_number(fitted: Path) -> None:
    process = subprocess.Popen(
        [sys.executable, "-m", "mphygs", "view", fitted, "--port", "0", "--sequences", "swing", "--json"],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )  # fmt: skip
    try:
        address = ""
        while not address:
            line = process.stderr.readline()
            assert line, "the viewer ended before it served anything"
            found = re.search(r"http://127\.0\.0\.1:\d+/", line)
            address = found.group() if found else ""
        with urllib.request.urlopen(address, timeout=60) as reply:
            page = reply.read().decode()
        assert 'data-key="bar.youngs_modulus"' in page and 'id="viewer"' in page
        now = np.log(load_run(fitted).belief["bar.youngs_modulus"].value)
        same = post(address, {"sequence": "swing", "parameters": {"bar.youngs_modulus": now}})
        soft = post(address, {"sequence": "swing", "parameters": {"bar.youngs_modulus": now - 0.7}})
        assert same["rms"] < 5e-4 < 4 * same["rms"] < soft["rms"]
        assert soft["motion"]["predicted"] != same["motion"]["predicted"]
        assert "expected one of swing" in post(address, {"sequence": "x", "parameters": {}})["error"]
        assert "expected a number" in post(
            address, {"sequence": "swing", "parameters": {"bar.youngs_modulus": "stiff"}}
        )["error"]
    finally:
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=60)
    assert process.returncode == 0, err
    assert json.loads(out) == {"run": str(fitted), "address": address}


def test_sliders_stay_within_bounds(fitted: Path) -> None:
    belief = load_run(fitted).belief
    low, now, high = reach_of(belief["bar.youngs_modulus"])
    assert low < now < high and now == pytest.approx(np.log(belief["bar.youngs_modulus"].value))
    moved = moved_belief(belief, {"bar.youngs_modulus": 1e3})
    assert moved["bar.youngs_modulus"].value == belief["bar.youngs_modulus"].upper
    with pytest.raises(ValueError, match="expected one of bar.youngs_modulus"):
        moved_belief(belief, {"bar.density": 1.0})


def test_refuses_a_port_that_is_none(fitted: Path) -> None:
    code, _, err = call(view.main, fitted, "--port", "99999")
    assert code == 2 and "expected 0 to 65535" in err and err.count("\n") == 1
