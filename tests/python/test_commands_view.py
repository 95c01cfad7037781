"""The live viewer: the page, the motion that follows a number, and what it refuses."""

import json
import re
import signal
import socket
import struct
import subprocess
import sys
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from command_example import SIGMA, SPACING, answer, call, make_capture
from mphygs.commands import extend, fit, view
from mphygs.fit.run import load_run
from mphygs.report.live import moved_belief, reach_of
from page_driver import opened


@pytest.fixture(scope="module")
def fitted(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("view")
    capture = make_capture(folder / "capture")
    return Path(answer(fit.main, capture, "--out", folder / "run", "--spacing", SPACING)["run"])


def post(address: str, document: object) -> dict:
    request = urllib.request.Request(address + "motion", json.dumps(document).encode(), method="POST")
    with urllib.request.urlopen(request, timeout=120) as reply:
        return json.loads(reply.read())


@pytest.fixture(scope="module")
def viscous(fitted: Path) -> Path:
    out = fitted.parent / "viscous"
    return Path(answer(extend.main, fitted, "viscosity", "--out", out)["run"])


@contextmanager
def served(run: Path, *options: str) -> Iterator[tuple[str, subprocess.Popen]]:
    """The address of a viewer that is up, and its process."""
    process = subprocess.Popen(
        [sys.executable, "-m", "mphygs", "view", run, "--port", "0", "--sequences", "swing", *options],
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
        yield address, process
    finally:
        if process.poll() is None:
            process.send_signal(signal.SIGINT)
            process.communicate(timeout=60)


def test_serves_the_page_and_follows_a_number(fitted: Path) -> None:
    with served(fitted, "--json") as (address, process):
        with urllib.request.urlopen(address, timeout=60) as reply:
            page = reply.read().decode()
        assert 'data-key="bar.youngs_modulus"' in page and 'id="scene"' in page
        now = np.log(load_run(fitted).belief["bar.youngs_modulus"].value)
        same = post(address, {"sequence": "swing", "parameters": {"bar.youngs_modulus": now}})
        soft = post(address, {"sequence": "swing", "parameters": {"bar.youngs_modulus": now - 0.7}})
        assert same["rms"] < 5e-4 < 4 * same["rms"] < soft["rms"]
        assert same["over_noise"] == pytest.approx(same["rms"] / (SIGMA * np.sqrt(3.0)))
        assert soft["motion"]["models"] != same["motion"]["models"]
        assert "expected one of swing" in post(address, {"sequence": "x", "parameters": {}})["error"]
        wrong = {"sequence": "swing", "parameters": {"bar.youngs_modulus": "stiff"}}
        assert "expected a number" in post(address, wrong)["error"]
        without = {"sequence": "swing", "parameters": {}, "without": ["wind"]}
        assert "effect 'wind': expected one of none" in post(address, without)["error"]
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=60)
    assert process.returncode == 0, err
    assert json.loads(out) == {"run": str(fitted), "address": address}


def asked(address: str, head: str, body: bytes = b"") -> bytes:
    """What the viewer answers to a request as it stands."""
    port = int(address.rsplit(":", 1)[1].strip("/"))
    with socket.create_connection(("127.0.0.1", port), timeout=60) as connection:
        connection.sendall(head.replace("\n", "\r\n").encode() + b"\r\n\r\n" + body)
        connection.shutdown(socket.SHUT_WR)
        return b"".join(iter(lambda: connection.recv(65536), b""))


def test_bad_and_foreign_requests_are_refused_and_leave_no_trace(fitted: Path) -> None:
    with served(fitted) as (address, process):
        own = address.removeprefix("http://").strip("/")
        post_head = f"POST /motion HTTP/1.1\nHost: {own}\n"
        refused = (
            (f"GET / HTTP/1.1\nHost: evil.example:{own.rsplit(':', 1)[1]}", b"", b"403"),
            ("GET / HTTP/1.1", b"", b"403"),
            (f"{post_head}Origin: http://evil.example\nContent-Length: 2", b"{}", b"403"),
            (f"GET /../etc/passwd HTTP/1.1\nHost: {own}", b"", b"404"),
            (f"{post_head}Content-Length: many", b"", b"400"),
            (f"{post_head}Content-Length: -5", b"", b"400"),
            (f"{post_head}Content-Length: 99999999", b"{}", b"400"),
            (f"{post_head}Content-Length: 2", b"{}", b"400"),
            (f"{post_head}Content-Length: 4", b"\xff\xfe\x00[", b"400"),
            (f"{post_head}Content-Length: 40000", b"[" * 40000, b"400"),
        )
        for head, body, code in refused:
            assert code in asked(address, head, body).splitlines()[0], head
        assert b"Error code: 400" in asked(address, "NONSENSE")
        port = int(own.rsplit(":", 1)[1])
        gone = socket.create_connection(("127.0.0.1", port))
        gone.sendall(f"GET / HTTP/1.1\r\nHost: {own}\r\n\r\n".encode())
        gone.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        gone.close()
        with urllib.request.urlopen(address.replace("127.0.0.1", "localhost"), timeout=60) as reply:
            assert reply.status == 200
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=60)
    assert process.returncode == 0 and "Traceback" not in err and "Error" not in err


def test_a_switched_off_effect_shows_what_it_did(viscous: Path) -> None:
    with served(viscous) as (address, _), opened(address, offline=False) as page:
        told = "document.getElementById('scene').dataset.rms"
        page.locator("#scene [data-role=time]").evaluate(
            "s => { s.value = s.max; s.dispatchEvent(new Event('input')); }"
        )
        on = float(page.evaluate(told))
        page.get_by_label("viscosity", exact=True).uncheck()
        page.wait_for_function("document.getElementById('status').dataset.rms", timeout=120_000)
        assert float(page.evaluate(told)) > 2 * on
        assert page.locator("[data-key='viscosity.eta']").is_disabled()
        page.get_by_label("viscosity", exact=True).check()
        page.wait_for_function(f"Math.abs({told} - {on}) < 1e-6", timeout=120_000)
        slider = page.locator("[data-key='bar.youngs_modulus']")
        slider.evaluate("s => { s.value = s.min; s.dispatchEvent(new Event('input')); }")
        page.wait_for_function(f"{told} > {2 * on}", timeout=120_000)
        assert "times the noise" in page.locator("#status").inner_text()


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
