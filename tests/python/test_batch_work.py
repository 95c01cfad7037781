"""One run of a batch: a command in a process of its own, which ends with its worker."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import pytest

from batch_example import task
from mphygs.batch import cluster, work
from mphygs.capture.folder_mark import is_held
from mphygs.commands.in_use import held, hold

PRINTS = """
import os, sys, time
print("said", flush=True, file=sys.stderr)
names = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
open("heard", "a").write(" ".join(sys.argv[1:]) + "\\n")
if "--resume" in sys.argv and os.path.exists("refuse"):
    sys.stderr.write("mphygs fit: nothing to go on with\\n")
    sys.exit(2)
try:
    time.sleep(float(os.environ.get("SLEEP", "0")))
except KeyboardInterrupt:
    sys.stderr.write("mphygs fit: interrupted\\n")
    sys.exit(130)
print('{"threads": "' + " ".join(os.environ[n] for n in names) + '"}')
"""


@pytest.fixture
def scripted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder in which a script takes the place of the package that a run's process runs."""
    (tmp_path / "mphygs.py").write_text(PRINTS)
    alone = Path(work.__file__).with_name("child_process.py").read_text(encoding="utf-8")
    (tmp_path / "alone.py").write_text(alone.replace("GRACE = 10.0", "GRACE = 2.0"))

    def popen(line: list[str], **known: object) -> subprocess.Popen:
        return subprocess.Popen([sys.executable, str(tmp_path / "alone.py"), *line[3:]], **known)

    monkeypatch.setattr(work, "subprocess", SimpleNamespace(Popen=popen, PIPE=subprocess.PIPE))
    return tmp_path


def heard(folder: Path) -> list[str]:
    return (folder / "heard").read_text().splitlines()


def test_a_run_has_the_threads_of_its_worker(scripted: Path) -> None:
    found = work.work(task("a", scripted), 3)
    assert found.done and found.answer == {"threads": "3 3 3"}
    assert heard(scripted) == ["fit x --json --workers 3"]
    assert work.work(task("b", scripted, limited=False, words=("segment",)), 1).answer == {"threads": "1 1 1"}
    assert heard(scripted)[1] == "segment --json"


def test_a_script_is_run_in_the_place_of_the_package(scripted: Path) -> None:
    beside = "import json, sys, beside\nprint(json.dumps({'given': sys.argv[1:], 'by': beside.WHO}))\n"
    (scripted / "scripts").mkdir()
    (scripted / "scripts" / "one.py").write_text(beside)
    (scripted / "scripts" / "beside.py").write_text("WHO = 'it'\n")
    asked = task("a", scripted, words=("b", "c"), limited=False, script=scripted / "scripts" / "one.py")
    assert work.work(asked, 1).answer == {"given": ["b", "c", "--json"], "by": "it"}
    assert not (scripted / "heard").exists()


def test_what_a_run_took_is_told(scripted: Path) -> None:
    held = "x = b'1' * 200_000_000"
    busy = f"import time\n{held}\nwhile time.process_time() < 0.7: pass\ntime.sleep(0.5)\nprint('{{}}')"
    (scripted / "mphygs.py").write_text(busy)
    found = work.work(task("a", scripted), 1)
    assert 0.6 < found.processor < found.seconds and found.seconds > 1.1
    assert 2e8 < found.memory < 1e9


def test_the_end_of_a_run_is_not_waited_for(scripted: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(work, "TICK", 600.0)
    assert work.work(task("a", scripted), 1).seconds < 300.0
    ends = []
    client = SimpleNamespace(submit=lambda *_, **__: SimpleNamespace(add_done_callback=ends.append))
    workers = cluster.Workers(client)
    workers.submit("here", task("a"), 1)
    ends[0](None)
    begin = time.monotonic()
    workers.wait(600.0)
    assert time.monotonic() < begin + 300.0
    workers.wait(0.0)


def test_a_run_that_was_begun_goes_on_or_begins_anew(scripted: Path) -> None:
    for _ in range(2):
        assert work.work(task("a", scripted), 1).done
    assert heard(scripted)[1:] == ["fit x --json --workers 1 --resume"]
    (scripted / "refuse").touch()
    assert work.work(task("a", scripted), 1).done
    assert heard(scripted)[2:] == ["fit x --json --workers 1 --resume", "fit x --json --workers 1"]


def test_a_run_that_nobody_wants_is_interrupted(scripted: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SLEEP", "60")
    begin = time.monotonic()
    log = task("a", scripted).log
    found = work.work(
        task("a", scripted), 1, withdrawn=lambda: log.exists() and "said" in log.read_text()
    )
    assert time.monotonic() - begin < 30.0
    assert (found.code, found.line, found.done) == (130, "interrupted", False)


def test_a_run_ends_with_the_worker_that_began_it(scripted: Path) -> None:
    line = [sys.executable, str(scripted / "alone.py"), "fit"]
    environment = os.environ | {"SLEEP": "60", "PYTHONPATH": str(scripted)}
    worker = f"""
import subprocess, sys, time
child = subprocess.Popen({line!r}, stdin=subprocess.PIPE, start_new_session=True)
print(child.pid, flush=True)
time.sleep(60)
"""
    began = subprocess.Popen(
        [sys.executable, "-c", worker], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True,
        cwd=scripted, env=environment,
    )  # fmt: skip
    child = int(began.stdout.readline())
    until = time.monotonic() + 30.0
    while not (scripted / "heard").exists() and time.monotonic() < until:
        time.sleep(0.05)
    began.kill()
    began.wait()
    began.stdout.close()
    while _runs(child) and time.monotonic() < until:
        time.sleep(0.05)
    assert not _runs(child)


def _runs(process: int) -> bool:
    try:
        state = Path(f"/proc/{process}/stat").read_text().rsplit(")", 1)[1].split()[0]
    except OSError:
        return False
    return state != "Z"


def test_a_run_that_is_killed_says_so(scripted: Path) -> None:
    (scripted / "mphygs.py").write_text(f"import os; os.kill(os.getpid(), {int(signal.SIGKILL)})")
    found = work.work(task("a", scripted), 1)
    assert found.line == "was ended by SIGKILL" and not found.done


def test_a_folder_that_is_still_written_to_is_waited_for(scripted: Path) -> None:
    with held():
        hold(scripted / "a")
        began = time.monotonic()
        assert work.work(task("a", scripted), 1, patience=1.0).done
        assert time.monotonic() - began > 1.0
    began = time.monotonic()
    assert not is_held(scripted / "a") and not is_held(scripted / "none")


def test_a_worker_that_cannot_run_it_fails_that_run_alone() -> None:
    class Broken:
        def result(self) -> None:
            raise ModuleNotFoundError("No module named 'mphygs'")

    found = cluster._Future(Broken()).result()
    assert not found.done and "No module named 'mphygs'" in found.line
