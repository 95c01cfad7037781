"""Batches on workers of dask.distributed: on this machine, lost in the middle, and of another scheduler."""

from __future__ import annotations

import contextlib
import csv
import importlib.util
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from safetensors.numpy import load_file

from command_example import answer, make_capture
from mphygs.batch.cluster import UNWATCHED, local_workers
from mphygs.commands import fit

WITHOUT = importlib.util.find_spec("distributed") is None
pytestmark = [pytest.mark.slow, pytest.mark.skipif(WITHOUT, reason="dask.distributed is not installed")]
# Fine enough for a run to be caught in its middle.
OPTIONS = ("--spacing", "0.004")
LONGEST = 300.0  # seconds


@pytest.fixture(scope="module")
def captures(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    root = tmp_path_factory.mktemp("captures")
    return [make_capture(root / f"bar{k}", eta=20.0 * k) for k in range(3)]


@pytest.fixture(scope="module")
def alone(captures: list[Path], tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """The runs of the captures as they come by themselves, by name."""
    root = tmp_path_factory.mktemp("alone")
    for capture in captures:
        answer(fit.main, capture, "--out", root / capture.name, *OPTIONS)
    return {capture.name: root / capture.name for capture in captures}


def begun(*words: object) -> subprocess.Popen:
    line = [sys.executable, "-m", "mphygs.batch", *map(str, words)]
    return subprocess.Popen(
        line, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    )


def ended(process: subprocess.Popen, code: int) -> tuple[str, str]:
    out, err = process.communicate(timeout=LONGEST)
    assert process.returncode == code, err
    return out, err


def processes(out: Path) -> list[tuple[int, int]]:
    """Process and parent of every run under way in a folder."""
    found = []
    for entry in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            words = (entry / "cmdline").read_bytes().split(b"\0")
            parent = int((entry / "stat").read_text().rsplit(")", 1)[1].split()[1])
            if b"mphygs.batch.child_process" in words and any(os.fsencode(out) in word for word in words):
                found.append((int(entry.name), parent))
    return found


def caught(process: subprocess.Popen, out: Path) -> tuple[int, int]:
    """A run in its middle: process and parent."""
    until = time.monotonic() + LONGEST
    while time.monotonic() < until and process.poll() is None:
        if any("%" in log.read_text() for log in out.glob("logs/*.log")) and (found := processes(out)):
            return found[0]
        time.sleep(0.05)
    raise AssertionError(process.communicate()[1])


def same(out: Path, alone: dict[str, Path]) -> None:
    """Every run is to the bit what it is by itself."""
    for name, run in alone.items():
        found, expected = (load_file(folder / "numbers.safetensors") for folder in (out / name, run))
        assert found.keys() == expected.keys()
        for key in found:
            np.testing.assert_array_equal(found[key], expected[key])
        documents = [json.loads((folder / "run.json").read_text()) for folder in (out / name, run)]
        assert documents[0]["belief"] == documents[1]["belief"]
        for key in ("parameters", "sequences"):
            assert documents[0]["answer"][key] == documents[1]["answer"][key]


def test_two_workers_of_this_machine_give_the_same_to_the_bit(
    captures: list[Path], alone: dict[str, Path], tmp_path: Path
) -> None:
    out = tmp_path / "out"
    line = (*captures, tmp_path, "--command", "fit", "--out", out, "--workers", 2, "--json")
    process = begun(*line, "--", *OPTIONS)
    caught(process, out)
    said, err = ended(process, 1)
    found = json.loads(said)
    assert [run["state"] for run in found["runs"]] == ["done"] * 3 + ["failed"]
    assert "4 of 4 done, 1 failed" in err and "is not a capture" in found["runs"][-1]["line"]
    same(out, alone)
    with (out / "summary.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    for row in rows[:3]:
        value = load_file(alone[row["run"]] / "numbers.safetensors")["values"][0]
        assert float(row["bar.youngs_modulus [Pa]"]) == value


def test_two_batches_at_a_time_do_not_meet_and_dask_watches_neither() -> None:
    import dask
    import distributed  # noqa: F401  # its own settings are there once it is

    before = {key: dask.config.get(key, None) for key in UNWATCHED}
    assert before != UNWATCHED
    # a port that both ask for would be a warning, which fails
    with local_workers(1, 1) as first, local_workers(1, 1) as second:
        for pool in (first, second):
            told = pool.client.run(lambda: {key: dask.config.get(key) for key in UNWATCHED})
            assert list(told.values()) == [UNWATCHED]
            assert len(pool.threads()) == 1
        assert first.threads().keys() != second.threads().keys()
    assert {key: dask.config.get(key, None) for key in UNWATCHED} == before


@pytest.mark.parametrize("lost", ["worker", "run"])
def test_a_worker_killed_in_the_middle_loses_nothing(
    lost: str, captures: list[Path], alone: dict[str, Path], tmp_path: Path
) -> None:
    out = tmp_path / "out"
    process = begun(*captures, "--command", "fit", "--out", out, "--workers", 2, "--", *OPTIONS)
    run, worker = caught(process, out)
    os.kill(worker if lost == "worker" else run, signal.SIGKILL)
    if lost == "run":
        said, _ = ended(process, 1)
        assert "was ended by SIGKILL" in said
        ended(begun("--out", out, "--workers", 1, "--resume"), 0)
    else:
        ended(process, 0)
    same(out, alone)


def test_an_interrupted_batch_goes_on(captures: list[Path], alone: dict[str, Path], tmp_path: Path) -> None:
    out = tmp_path / "out"
    process = begun(*captures, "--command", "fit", "--out", out, "--workers", 1, "--", *OPTIONS)
    caught(process, out)
    os.killpg(process.pid, signal.SIGINT)
    said, err = ended(process, 130)
    assert said == "" and "Traceback" not in err
    assert err.splitlines()[-1].endswith(f"continue with: mphygs batch --out {out} --workers 1 --resume")
    ended(begun("--out", out, "--workers", 1, "--resume"), 0)
    assert not processes(out)
    same(out, alone)


@contextlib.contextmanager
def scheduler(folder: Path, workers: int, threads: int) -> Iterator[str]:
    """Address of a scheduler on the loopback address, with workers in processes of their own."""
    file = folder / "scheduler.json"
    line = [sys.executable, "-m", "distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", "0"]
    line += ["--no-dashboard", "--scheduler-file", str(file)]
    started = [subprocess.Popen(line, stderr=subprocess.DEVNULL)]
    try:
        until = time.monotonic() + LONGEST
        while not file.is_file() and time.monotonic() < until:
            time.sleep(0.1)
        address = json.loads(file.read_text())["address"]
        line = [sys.executable, "-m", "distributed.cli.dask_worker", address, "--no-nanny", "--no-dashboard"]
        line += ["--nthreads", str(threads), "--local-directory", str(folder)]
        started += [subprocess.Popen(line, stderr=subprocess.DEVNULL) for _ in range(workers)]
        yield address
    finally:
        for process in reversed(started):
            process.terminate()
            process.wait(60)


def test_a_scheduler_that_is_there_has_two_worker_processes(
    captures: list[Path], alone: dict[str, Path], tmp_path: Path
) -> None:
    out = tmp_path / "out"
    with scheduler(tmp_path, workers=2, threads=1) as address:
        process = begun(*captures, "--command", "fit", "--scheduler", address, "--out", out, "--", *OPTIONS)
        caught(process, out)
        while len({parent for _, parent in processes(out)}) < 2:
            assert process.poll() is None, "both workers have a run at a time"
            time.sleep(0.05)
        for run, _ in processes(out):
            words = Path(f"/proc/{run}/cmdline").read_bytes().split(b"\0")
            assert words[words.index(b"--workers") + 1] == b"1"
            assert b"OMP_NUM_THREADS=1" in Path(f"/proc/{run}/environ").read_bytes().split(b"\0")
        ended(process, 0)
        same(out, alone)
        # who asked for the runs is gone: they end too
        process = begun(*captures, "--command", "fit", "--scheduler", address, "--out", out, "--", *OPTIONS)
        caught(process, out)
        process.kill()
        process.communicate()
        until = time.monotonic() + 60.0
        while processes(out) and time.monotonic() < until:
            time.sleep(0.1)
        assert not processes(out)
        ended(begun("--out", out, "--scheduler", address, "--resume"), 0)
    same(out, alone)
