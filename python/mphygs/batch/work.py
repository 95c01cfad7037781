"""What a worker does with one run: the command in a process of its own, with the worker's threads."""

from __future__ import annotations

import json
import os
import re
import resource
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from mphygs.batch.child_process import SCRIPT
from mphygs.capture.errors import one_line
from mphygs.capture.folder_mark import is_held

# Every library that a command loads takes its number of threads from one of these.
THREADS = (
    "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMEXPR_NUM_THREADS",
    "OPENCV_FOR_THREADS_NUM",
)  # fmt: skip
# Seconds between two looks at a run.
TICK = 0.2
# How long a process outlives the worker that began it, at most [s].
PATIENCE = 30.0
# Bytes of what the system counts memory in.
_MEMORY = 1 if sys.platform == "darwin" else 1024
# Exit codes of a command that fails, and of one that refuses its input or its options.
FAILED, REFUSED = 1, 2


@dataclass(frozen=True)
class Task:
    """One run of a batch.

    name: of the run in the batch; folder: that the command is run on; words: of its command line, without
    those that a worker adds; run: its own run folder, None where the command writes where it always does;
    logs: folder of what it says and of what came of it; place: folder that relative paths are meant from;
    limited, resumable: whether the command takes --workers and --resume; seed, effects: told apart by, where
    they are; script: that `words` are for, in the place of mphygs.
    """

    name: str
    folder: str
    words: tuple[str, ...]
    run: Path | None
    logs: Path
    place: Path
    limited: bool
    resumable: bool
    seed: int | None = None
    effects: str | None = None
    script: Path | None = None

    @property
    def log(self) -> Path:
        """File of what the command says while it works."""
        return self.logs / f"{self.name}.log"

    @property
    def outcome(self) -> Path:
        """File of what came of it."""
        return self.logs / f"{self.name}.json"


@dataclass(frozen=True)
class Outcome:
    """What came of a run. code: exit code; line: that it failed with; answer: its JSON, None where it failed;
    seconds, processor: that it took, and those of the processor, what was before an interruption not counted;
    memory: at its peak [byte]."""

    code: int
    line: str
    answer: dict[str, object] | None
    seconds: float
    processor: float = 0.0
    memory: int = 0

    @property
    def done(self) -> bool:
        """Whether there is an answer."""
        return self.code == 0 and self.answer is not None


def work(
    task: Task,
    threads: int,
    *,
    withdrawn: Callable[[], bool] = lambda: False,
    patience: float = PATIENCE,
) -> Outcome:
    """Run a task to its end, going on where an earlier worker left it. threads: that it may have.

    withdrawn: whether nobody wants it any more, on which it is interrupted; patience: how long a folder is
    waited for that is still written to, as by what a lost worker had begun [s].
    """
    where = task.run if task.run is not None else task.place / task.folder
    begin = time.monotonic()
    while is_held(where) and time.monotonic() < begin + patience and not withdrawn():
        time.sleep(TICK)
    begun = task.log.exists()
    task.log.parent.mkdir(parents=True, exist_ok=True)
    begin = time.monotonic()
    more = ["--json", *(["--workers", str(threads)] if task.limited else [])]
    outcome = None
    if begun and task.resumable:
        outcome = _run(task, [*task.words, *more, "--resume"], threads, withdrawn, begin)
    # What was broken off before there was anything to go on with begins anew.
    if outcome is None or (outcome.code == REFUSED and not withdrawn()):
        outcome = _run(task, [*task.words, *more], threads, withdrawn, begin)
    return outcome


def _run(
    task: Task, words: Sequence[str], threads: int, withdrawn: Callable[[], bool], begin: float
) -> Outcome:
    """One process of a command from its beginning to its end."""
    environment = dict(os.environ) | {name: str(threads) for name in THREADS}
    if task.script is not None:
        environment[SCRIPT] = str(task.script)
    with tempfile.TemporaryFile() as said, task.log.open("ab") as log:
        process = subprocess.Popen(
            [sys.executable, "-m", "mphygs.batch.child_process", *words],
            stdin=subprocess.PIPE,
            stdout=said,
            stderr=log,
            cwd=task.place,
            env=environment,
            start_new_session=True,
        )
        usages: list[resource.struct_rusage] = []
        waiter = threading.Thread(target=lambda: usages.append(_usage(process)), daemon=True)
        waiter.start()
        while waiter.is_alive():
            if withdrawn() and not process.stdin.closed:
                process.stdin.close()
            waiter.join(TICK)
        (usage,) = usages
        process.stdin.close()
        said.seek(0)
        answer = _answer(said.read()) if process.returncode == 0 else None
    line = "" if answer is not None else _complaint(task, process.returncode)
    seconds, processor = time.monotonic() - begin, usage.ru_utime + usage.ru_stime
    return Outcome(process.returncode, line, answer, seconds, processor, _MEMORY * usage.ru_maxrss)


def _usage(process: subprocess.Popen) -> resource.struct_rusage:
    """What a process has used with all that it began, once it has ended."""
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    return usage


def _answer(said: bytes) -> dict[str, object] | None:
    try:
        found = json.loads(said)
    except ValueError:
        return None
    return found if isinstance(found, dict) else None


def _complaint(task: Task, code: int) -> str:
    """The line that a command ended with."""
    if code < 0:
        return f"was ended by {signal.Signals(-code).name}"
    return last_line(task.log).removeprefix(f"mphygs {task.words[0]}: ") or f"ended with exit code {code}"


def last_line(log: Path) -> str:
    """The last line that a run has said, without its share; empty where it has said nothing."""
    try:
        with log.open("rb") as stream:
            stream.seek(max(0, log.stat().st_size - 8192))
            lines = stream.read().decode(errors="replace").splitlines()
    except OSError:
        return ""
    last = next((line for line in reversed(lines) if line.strip()), "")
    return one_line(re.sub(r"\x1b\[[0-9;]*m", "", last))
